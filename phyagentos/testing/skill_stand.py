"""A stand for skills: sessions on doubles in a folder, with the real runner, guard, recorder and tree runtime."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from phyagentos.clock import Clock
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.evidence import read_bundle
from phyagentos.protocol.sessions.session import Execution, Session
from phyagentos.protocol.settings.safety import TargetLimits, read_safety
from phyagentos.protocol.world.environment import Entity
from phyagentos.runtime.actions.handle import TargetSessionHandle
from phyagentos.runtime.execution.leaf import Leaf
from phyagentos.runtime.execution.leaf_registry import LeafRegistry, build_registry
from phyagentos.runtime.execution.loop import Cancel
from phyagentos.runtime.execution.port_types import EXPORTED_TYPES, PORT_TYPES
from phyagentos.runtime.motion.process import Planner
from phyagentos.runtime.perception.world_model import GroundTruthWorldModel
from phyagentos.runtime.policies.policy_runtime import Policies
from phyagentos.runtime.worker.embodiment import Embodiment, SkillLoader
from phyagentos.runtime.worker.recorder import Bundles
from phyagentos.runtime.worker.runner import SessionRunner
from phyagentos.testing.doubles import DirectConnection, PerfectTarget, ScriptedPlanner
from phyagentos.testing.manual_clock import ManualClock
from phyagentos.testing.worlds import make_contract

ONE_LEAF = "one_leaf"
ROBOT = "panda"


@dataclass(frozen=True, slots=True)
class LeafRun:
    """How one activation of a leaf ended: its status, coded reason, sentence, numbers and outputs."""

    status: str
    code: str
    message: str
    numbers: dict[str, Any]
    outputs: dict[str, Any]


def read_robot(name: str = ROBOT) -> tuple[TargetProfile, TargetLimits]:
    """Profile and limits of a robot that ships."""
    root = find_shipped_root()
    profile = read_target(root / "robots" / name / "target.yaml")
    return profile, read_safety(root / "protocol" / "safety.yaml").targets[name]


class SkillStand:
    """Runs sessions of one robot on doubles, and keeps their evidence below `folder`.

    Args:
        entities: What the world holds; None for what `target` holds already.
        library: Trees and skills; those of `folder` and those that ship without one.
        settings: Settings files, whose hashes go to the evidence.

    Attributes:
        beats: What the runner published, in order.
    """

    def __init__(
        self,
        folder: Path,
        *,
        entities: Iterable[Entity] = (),
        target: PerfectTarget | None = None,
        planner: Planner | None = None,
        library: Library | None = None,
        registry: LeafRegistry | None = None,
        clock: Clock | None = None,
        policies: Callable[[TargetSessionHandle], Policies] | None = None,
        settings: Iterable[Path] = (),
        robot: tuple[TargetProfile, TargetLimits] | None = None,
    ) -> None:
        profile, limits = robot or read_robot()
        self.workspace = folder
        self.library = library or Library((folder, find_shipped_root()))
        self.registry = registry or build_registry(self.library)
        self.target = target or PerfectTarget(profile, entities)
        self.planner = planner or ScriptedPlanner()
        self.clock = clock or ManualClock()
        self.handle = TargetSessionHandle(DirectConnection(self.target), limits, sees_truth=True)
        self.beats: list[dict[str, Any]] = []
        world = GroundTruthWorldModel(profile.target, self.handle, profile=profile)
        self.runner = SessionRunner(
            target=Embodiment(handle=self.handle, world=world, profile=profile, limits=limits),
            skills=SkillLoader(
                planner=self.planner,
                library=self.library,
                registry=self.registry,
                policies=policies(self.handle) if policies is not None else None,
            ),
            bundles=Bundles(folder, settings=tuple(settings)),
            clock=self.clock,
        )

    def run(
        self,
        session: Session,
        tree: str = "",
        *,
        cancel: Cancel = lambda: None,
        policy: str = "",
        plan: Mapping[str, Any] | None = None,
    ) -> Execution:
        """Carry out one session by a tree, or by the policy that `policy` names; its own skill's tree without."""
        self.handle.load(session.scene)
        adapter = {"policy_adapter": policy} if policy else {}
        return self.runner.run(
            session,
            1,
            {"tree": tree or session.skill, **adapter, **(plan or {})},
            evidence=f"evidence/{session.id}",
            cancel=cancel,
            beat=lambda **beat: self.beats.append(beat),
        )

    def run_leaf(self, leaf: type[Leaf], /, **inputs: Any) -> LeafRun:
        """One activation of a leaf as the only node of a tree, with plain values for its inputs, to its end."""
        registered = {name for name in self.registry.names() if self.registry.find(name) is leaf}
        name = next(iter(registered), "leaf_under_test")
        if not registered:
            self.registry.register(name, leaf)
        types = {kind: type_name for type_name, kind in PORT_TYPES.items() if type_name in EXPORTED_TYPES}
        outputs = {port: types[each.data_type] for port, each in leaf.OUTPUT_PORTS.items() if each.data_type in types}
        tree = {
            "tree": ONE_LEAF,
            "description": "The leaf under test.",
            "outputs": {port: {"type": each} for port, each in outputs.items()},
            "root": {name: inputs | {port: f"${port}" for port in outputs}},
        }
        path = self.workspace / "trees" / f"{ONE_LEAF}.yaml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(yaml.safe_dump(tree), encoding="utf-8")
        session = make_contract(id=f"g.{ONE_LEAF}", skill=ONE_LEAF)
        execution = self.run(session)
        trace = read_bundle(self.workspace / execution.evidence, session, execution).trace
        end = next((each for each in reversed(trace) if each.leaf == name), None)
        if end is None:
            raise AssertionError(f"the leaf did not run: {execution.code} {execution.message}")
        return LeafRun(end.status, end.code, end.message, end.numbers, execution.outputs)
