"""The scorer `simulator`: conditions on the recorded state of a MuJoCo simulation, `{in_tray: [red_cube, red_tray]}`.

A condition is a function `is_…` of `simulator_state`, or another `module:function` that gets the folder of a bundle
first, with its arguments, as a list or by name.
"""

import inspect
import pkgutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from phyagentos.bench.scorers.scorer import Scorer
from phyagentos.errors import Problem
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import Address, Located
from phyagentos.protocol.sessions.evidence import SCENE_MODEL, TERMINAL
from phyagentos.protocol.workspace.array_files import read_arrays


def _list_conditions() -> dict[str, Callable[..., bool]]:
    from phyagentos.bench.scorers import simulator_state  # loads MuJoCo

    return {name.removeprefix("is_"): each for name, each in vars(simulator_state).items() if name.startswith("is_")}


def _find_condition(name: str) -> Callable[..., bool]:
    """Raises KeyError, ImportError or AttributeError for one that is not there."""
    found: Callable[..., bool] = pkgutil.resolve_name(name) if ":" in name else _list_conditions()[name]
    return found


def _check(located: Located, path: Address, condition: Any) -> list[Problem]:
    if not isinstance(condition, dict) or len(condition) != 1:
        expected = "one condition, {NAME: [ARGUMENT, ...]} or {NAME: {ARGUMENT: VALUE}}"
        return [located.problem("INVALID_VALUE", path, repr(condition), expected)]
    ((name, arguments),) = condition.items()
    try:
        _bind(found := _find_condition(name), arguments, Path())
    except (KeyError, ImportError, AttributeError):
        return [located.unknown("condition", (*path, name), name, _list_conditions())]
    except TypeError as error:
        signature = [each for each in inspect.signature(found).parameters if each != "folder"]
        return [located.problem("INVALID_VALUE", (*path, name), str(error), ", ".join(signature))]
    return []


def _bind(condition: Callable[..., bool], arguments: Any, bundle: Path) -> inspect.BoundArguments:
    by_name = arguments if isinstance(arguments, dict) else {}
    in_order = arguments if isinstance(arguments, list) else () if by_name else (arguments,)
    return inspect.signature(condition).bind(bundle, *in_order, **by_name)


def _score(parts: Mapping[str, Any], workspace: Path, bundle: Path | None) -> dict[str, bool] | None:
    if bundle is None:
        ends = max((workspace / "evidence").glob(f"*/{TERMINAL}"), key=_read_time, default=workspace / TERMINAL)
        bundle = ends.parent
    if not ((bundle / TERMINAL).is_file() and (bundle / SCENE_MODEL).is_file()):
        return dict.fromkeys(parts, False)  # nothing was carried out
    found = {}
    for part, condition in parts.items():
        ((name, arguments),) = condition.items()
        is_there = _find_condition(name)
        bound = _bind(is_there, arguments, bundle)
        found[part] = is_there(*bound.args, **bound.kwargs)
    return found


def _read_time(end: Path) -> float:
    """Simulated time of a recorded end [s]."""
    return float(read_arrays(end)["time"])


def _list_bodies(condition: Fields) -> tuple[str, ...]:
    """Of the conditions that ship; what others are given is theirs."""
    ((name, arguments),) = condition.items()
    return () if ":" in name else _bind(_find_condition(name), arguments, Path()).args[1:]


SIMULATOR = Scorer(name="simulator", check=_check, score=_score, list_bodies=_list_bodies)
