"""What a suite names and others may provide: scorers, repair policies, drawn goals; announced or importable."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, cast

from phyagentos.agent.repair.recovery_policies import GraphRepair, RepairPolicy
from phyagentos.bench.scorers.scorer import OUTCOMES, VERDICT, Scorer
from phyagentos.bench.scorers.simulator import SIMULATOR
from phyagentos.plugins import Plugins, import_object

T = TypeVar("T")
SCORERS = Plugins[Scorer](
    "phyagentos.scorers", {each.name: each for each in (OUTCOMES, SIMULATOR, VERDICT)}, noun="scorer"
)
REPAIR_POLICIES = Plugins[Callable[[], RepairPolicy]](
    "phyagentos.repair_policies", {GraphRepair.name: GraphRepair}, noun="repair policy"
)
DRAWN = Plugins[Callable[[int, Path], str | Path]]("phyagentos.drawn_goals", noun="file")
FAULTS = "faults.yaml"  # of a drawn project


def load_scorer(name: str, address: str = "scorer") -> Scorer:
    """A scorer: one that ships, one that is announced, or `module:object`; raises `UNKNOWN_NAME`."""
    return _load(SCORERS, name, address)


def load_repair(name: str | None, address: str = "repair") -> RepairPolicy:
    """A new repair policy: `repair`, one that is announced, or `module:class`; raises `UNKNOWN_NAME`."""
    return _load(REPAIR_POLICIES, name or GraphRepair.name, address)()


def draw(name: str, seed: int, folder: Path, address: str = "graph") -> Path:
    """The goal graph of a seed: a `module:function` of seed and empty folder writes a project, and returns the path.

    The project holds what its goal needs, what its scorer goes by, and a `faults.yaml` where something shall go wrong.
    Raises DefinitionError `UNKNOWN_NAME`.
    """
    function = _load(DRAWN, name, address)
    folder.mkdir(parents=True, exist_ok=True)
    return Path(function(seed, folder))


def _load(plugins: Plugins[T], name: str, address: str) -> T:
    return cast("T", import_object(name, plugins.noun, address)) if ":" in name else plugins.load(name, address)
