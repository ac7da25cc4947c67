"""What a suite names and others may provide: scorers and repair policies, announced by packages or importable."""

from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from phyagentos.agent.repair.recovery_policies import GraphRepair, RepairPolicy
from phyagentos.bench.scorers.outcomes import OUTCOMES
from phyagentos.bench.scorers.scorer import Scorer
from phyagentos.bench.scorers.simulator import SIMULATOR
from phyagentos.errors import DefinitionError

SCORERS, REPAIR_POLICIES = "phyagentos.scorers", "phyagentos.repair_policies"  # entry point groups


def load_scorer(name: str, address: str = "scorer") -> Scorer:
    """A scorer: one that ships, one that is announced, or `module:object`; raises `UNKNOWN_SCORER`."""
    found: Scorer = _load(name, SCORERS, {each.name: each for each in (OUTCOMES, SIMULATOR)}, "UNKNOWN_SCORER", address)
    return found


def load_repair(name: str | None, address: str = "repair") -> RepairPolicy:
    """A new repair policy: `repair`, one that is announced, or `module:class`; raises `UNKNOWN_REPAIR`."""
    shipped = {GraphRepair.name: GraphRepair}
    found: RepairPolicy = _load(name or GraphRepair.name, REPAIR_POLICIES, shipped, "UNKNOWN_REPAIR", address)()
    return found


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
