"""What a suite names and others may provide: scorers, repair policies, drawn goals; announced or importable."""

from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from phyagentos.agent.repair.recovery_policies import GraphRepair, RepairPolicy
from phyagentos.bench.scorers.scorer import OUTCOMES, Scorer
from phyagentos.bench.scorers.simulator import SIMULATOR
from phyagentos.errors import DefinitionError

SCORERS, REPAIR_POLICIES, DRAWN = (f"phyagentos.{name}" for name in ("scorers", "repair_policies", "drawn_goals"))
FAULTS = "faults.yaml"  # of a drawn project


def load_scorer(name: str, address: str = "scorer") -> Scorer:
    """A scorer: one that ships, one that is announced, or `module:object`; raises `UNKNOWN_SCORER`."""
    found: Scorer = _load(name, SCORERS, {each.name: each for each in (OUTCOMES, SIMULATOR)}, "UNKNOWN_SCORER", address)
    return found


def load_repair(name: str | None, address: str = "repair") -> RepairPolicy:
    """A new repair policy: `repair`, one that is announced, or `module:class`; raises `UNKNOWN_REPAIR`."""
    shipped = {GraphRepair.name: GraphRepair}
    found: RepairPolicy = _load(name or GraphRepair.name, REPAIR_POLICIES, shipped, "UNKNOWN_REPAIR", address)()
    return found


def draw(name: str, seed: int, folder: Path, address: str = "graph") -> Path:
    """The goal graph of a seed: a `module:function` of seed and empty folder writes a project, and returns the path.

    The project holds what its goal needs, what its scorer goes by, and a `faults.yaml` where something shall go wrong.
    Raises DefinitionError `UNKNOWN_FILE`.
    """
    function = _load(name, DRAWN, {}, "UNKNOWN_FILE", address)
    folder.mkdir(parents=True, exist_ok=True)
    return Path(function(seed, folder))


def _load(name: str, group: str, shipped: Mapping[str, Any], code: str, address: str) -> Any:
    if name in shipped:
        return shipped[name]
    announced = {point.name: point for point in entry_points(group=group)}
    point = EntryPoint(name, name, group) if ":" in name else announced.get(name)
    if point is None:
        raise DefinitionError.unknown(code, address, name, (*shipped, *announced))
    try:
        return point.load()
    except (ImportError, AttributeError) as error:
        expected = "an object that can be imported from the working folder"
        raise DefinitionError.of(code, address, f"{name!r}: {error}", expected) from error
