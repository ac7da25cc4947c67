"""The verifier under one sensing: what it is shown of a case, and what it says."""

from pathlib import Path
from typing import Protocol

import msgspec
import numpy as np

from benchmarks.recorded import Robot
from benchmarks.verdict_parts import truth_sensing
from benchmarks.verdict_parts.cases import Lie
from benchmarks.verdict_parts.worlds import World
from phyagentos.agent.judging.goal_judgement import judge_carried
from phyagentos.agent.judging.verifier import History
from phyagentos.assembly.verification import build_verifier
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.verdicts import Attempt
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import Environment

TRUTH = "truth"
SHIPPED = Workspace(Path(__file__).resolve().parents[2] / "protocol")
VERIFIER = build_verifier(SHIPPED, SystemClock())
"""As an agent has it in a workspace with the shipped settings."""

LEVELS = (TRUTH, "none", "nominal", "harsh")


def judge_bundle(world: World, before: Environment, after: Environment, lie: Lie) -> Attempt:
    """The verdict on the recorded session with these snapshots; of a replan, where it happened earlier."""
    bundle = msgspec.structs.replace(world.recorded.bundle, before=before, after=after)
    if lie is not Lie.EARLIER:
        return VERIFIER.judge(bundle, History(max_replans=1))
    moved = {name: after.entities[name] for name in world.others if name in after.entities}
    later = msgspec.structs.replace(before, entities={**before.entities, **moved})
    begun = {text: before for text in bundle.session.accept if text.startswith("not moved(")}
    carried = judge_carried(bundle.session, after, begun)
    return VERIFIER.judge(msgspec.structs.replace(bundle, before=later), History(max_replans=1, carried=carried))


class Sensing(Protocol):
    """Shows cases to the verifier."""

    level: str

    def judge(self, right: np.ndarray, now: np.ndarray, lie: Lie, rng: np.random.Generator) -> Attempt:
        """The verdict on a world whose state is `now`, and was `right` when lying sensors last told the truth."""
        ...


class TruthSensing:
    """The simulator's own state is believed.

    Args:
        world: Of the cases.
    """

    level = TRUTH

    def __init__(self, world: World) -> None:
        self._world = world
        world.restore(world.recorded.before)
        self._before = truth_sensing.look(world, 1)

    def judge(self, right: np.ndarray, now: np.ndarray, lie: Lie, rng: np.random.Generator) -> Attempt:
        """The verdict; the bundle is that of the recorded session with other snapshots."""
        world = self._world
        world.restore(right)
        seen_right = truth_sensing.look(world)
        world.restore(now)
        after = truth_sensing.lie_about(truth_sensing.look(world), seen_right, world.object, lie, rng)
        before = truth_sensing.cover(self._before, world.object) if lie is Lie.COVERED else self._before
        return judge_bundle(world, before, after, lie)


def make_sensing(level: str, robot: Robot, world: World) -> Sensing:
    """The sensing of this name."""
    if level == TRUTH:
        return TruthSensing(world)
    from benchmarks.verdict_parts.perceived_sensing import PerceivedSensing

    return PerceivedSensing(level, robot, world)
