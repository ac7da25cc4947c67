"""The scorer `simulator`: conditions on the recorded state of a MuJoCo simulation, `{in_tray: [red_cube, red_tray]}`.

A condition is a function `is_…` of `simulator_state` with its arguments, as a list or by name.
"""

import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from phyagentos.bench.scorers.scorer import Scorer
from phyagentos.errors import Problem
from phyagentos.protocol.documents.schema import Address, Located
from phyagentos.protocol.sessions.evidence import SCENE_MODEL, TERMINAL


def _list_conditions() -> dict[str, Callable[..., bool]]:
    from phyagentos.bench.scorers import simulator_state  # loads MuJoCo

    return {name.removeprefix("is_"): each for name, each in vars(simulator_state).items() if name.startswith("is_")}


def _check(located: Located, path: Address, condition: Any) -> list[Problem]:
    known = _list_conditions()
    if not isinstance(condition, dict) or len(condition) != 1:
        expected = "one condition, {NAME: [ARGUMENT, ...]} or {NAME: {ARGUMENT: VALUE}}"
        return [located.problem("INVALID_VALUE", path, repr(condition), expected)]
    ((name, arguments),) = condition.items()
    if name not in known:
        return [located.unknown("UNKNOWN_NAME", (*path, name), name, known)]
    try:
        _bind(known[name], arguments, Path())
    except TypeError as error:
        signature = [each for each in inspect.signature(known[name]).parameters if each != "folder"]
        return [located.problem("WRONG_ARGUMENTS", (*path, name), str(error), ", ".join(signature))]
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
    known, found = _list_conditions(), {}
    for part, condition in parts.items():
        ((name, arguments),) = condition.items()
        bound = _bind(known[name], arguments, bundle)
        found[part] = known[name](*bound.args, **bound.kwargs)
    return found


def _read_time(end: Path) -> float:
    """Simulated time of a recorded end [s]."""
    with np.load(end) as terminal:
        return float(terminal["time"])


SIMULATOR = Scorer(name="simulator", check=_check, score=_score)
