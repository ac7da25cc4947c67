"""Bases of leaves that plan and of leaves that move: ask the planner, then play the motion that it answers."""

from typing import Any, final

import numpy as np
from msgspec import to_builtins

from phyagentos.geometry import compute_matrix
from phyagentos.protocol.world.environment import Entity
from phyagentos.runtime.execution.codes import FailureCode
from phyagentos.runtime.execution.leaf import Leaf, Status
from phyagentos.runtime.execution.trajectory_player import Progress, TrajectoryPlayer
from phyagentos.runtime.motion.requests import Approaches, Motion, MotionAnswer, MotionRequest, NoPlan, World
from phyagentos.runtime.perception.world_model import BELIEF

MOVED = ("object", "drawer")  # parameters that name what a skill moves; elsewhere contents are in the way
LOST_PERIODS = 5  # 0.1 s without contact on both sides; single contacts flicker for a period or two


class PlanningLeaf(Leaf):
    """A leaf whose result is an answer of the planner.

    Authors write `compose` (what to ask) and `on_answer` (what to do with it). A request is composed once the arm
    rests, so that it begins where the arm really is. Requests of parallel leaves follow one another in tree order.
    """

    _is_asked = False

    def compose(self) -> MotionRequest | Status:
        """The request, or a status when there is nothing to ask."""
        raise NotImplementedError(f"{type(self).__name__} must define compose")

    def on_answer(self, answer: MotionAnswer) -> Status:
        """Use the answer; refusals (`NoPlan`) are handled before."""
        raise NotImplementedError(f"{type(self).__name__} must define on_answer")

    def on_refused(self, answer: NoPlan) -> Status:
        """There is no plan; the planner's own code is the reason."""
        return self.fail(answer.code, answer.message, rejected=answer.rejected)

    @final
    def on_start(self) -> Status:
        """Ask."""
        self._is_asked = False
        return self.ask()

    def on_running(self) -> Status:
        """Wait for rest, then for the answer."""
        if not self._is_asked:
            return self.ask()
        answer = self.context.planner.poll()
        if answer is None:
            return Status.RUNNING
        self._is_asked = False
        self.context.note(
            "planner", type(answer).__name__, leaf=self.path, ms=answer.timing.ms, stages=to_builtins(answer.stages)
        )
        return self.on_refused(answer) if isinstance(answer, NoPlan) else self.on_answer(answer)

    def on_halted(self) -> None:
        """Cancel the request."""
        if self._is_asked:
            self.context.planner.cancel()
            self._is_asked = False

    def world(self) -> World:
        """The believed world, as the planner takes it: what is in a vessel that is moved goes with it, no obstacle."""
        environment = self.context.world.observe(BELIEF)
        entities, parameters = environment.entities.values(), self.context.session.parameters
        moved = {parameters.get(name) for name in MOVED}
        vessels = [each for each in entities if each.interior is not None and (each.held_by or each.name in moved)]
        return World(
            entities=tuple(entity for entity in entities if not any(_is_in(entity, vessel) for vessel in vessels)),
            regions=tuple(environment.regions.values()),
        )

    @final
    def ask(self) -> Status:
        """Submit what `compose` gives, once the arm rests and the planner is free."""
        if not (self.context.commands.at_rest and self.context.planner.is_free):
            return Status.RUNNING
        request = self.compose()
        if isinstance(request, Status):
            return request
        self.context.planner.submit(request)
        self._is_asked = True
        return Status.RUNNING


class ApproachPlanningLeaf(PlanningLeaf):
    """A leaf that asks for approaches and writes them to the port `approaches`."""

    @final
    def on_answer(self, answer: MotionAnswer) -> Status:
        """Write the approaches, name the labels."""
        if not isinstance(answer, Approaches):
            return self.fail(FailureCode.PLANNER_LOST, f"asked for approaches, got {type(answer).__name__}")
        self.write("approaches", answer)
        return self.succeed("", labels=[approach.label for approach in answer.approaches])


class LinePlanningLeaf(PlanningLeaf):
    """A leaf that asks for one straight way and writes it to the port `approach`."""

    @final
    def on_answer(self, answer: MotionAnswer) -> Status:
        """Write the way."""
        if not isinstance(answer, Approaches):
            return self.fail(FailureCode.PLANNER_LOST, f"asked for a line, got {type(answer).__name__}")
        self.write("approach", answer.approaches[0])
        return self.succeed("", label=answer.approaches[0].label)


class MovingLeaf(PlanningLeaf):
    """A leaf that plays a timed motion.

    Authors write `compose` and, where wanted, `on_arrived`. Set `_held` to the name of an entity to fail with
    `GRASP_LOST` when it leaves the fingers on the way.
    """

    _player: TrajectoryPlayer | None = None
    _held: str | None = None
    _lost_periods = 0

    def on_arrived(self, motion: Motion) -> Status:
        """The motion is complete."""
        return self.succeed("", **self.describe_motion(motion))

    @final
    def on_answer(self, answer: MotionAnswer) -> Status:
        """Begin to play."""
        if not isinstance(answer, Motion):
            return self.fail(FailureCode.PLANNER_LOST, f"asked for a motion, got {type(answer).__name__}")
        return self.play(answer)

    @final
    def on_running(self) -> Status:
        """Wait for the motion, then play it."""
        if self._player is None:
            return super().on_running()
        return self._continue(self._player)

    def on_halted(self) -> None:
        """Drop the request or the motion; the set-points brake by themselves."""
        self._player = None
        super().on_halted()

    @final
    def play(self, motion: Motion) -> Status:
        """Play a motion from this tick on."""
        context = self.context
        self._motion, self._lost_periods = motion, 0
        self._player = TrajectoryPlayer(motion.trajectory, context.commands, context.tracking_error_max_rad)
        return self._continue(self._player)

    @final
    def scale_speed(self, speed: float) -> float:
        """The wanted speed, slowed down where the strategy asks for it."""
        return speed * self.context.session.strategy.speed

    def describe_motion(self, motion: Motion) -> dict[str, Any]:
        """How the motion was found and followed, for the trace."""
        if self._player is None:
            return {}
        stages = motion.stages
        found = {
            key: value for part in (stages.path, stages.scaling) if part for key, value in to_builtins(part).items()
        }
        return {
            **found,
            "duration_s": round(motion.trajectory.duration_s, 6),
            "worst_tracking_error_rad": self._player.worst_error_rad,
        }

    def _continue(self, player: TrajectoryPlayer) -> Status:
        if self._held is not None and self._has_lost(self._held):
            self._player = None
            return self.fail(FailureCode.GRASP_LOST, f"{self._held} left the fingers", object=self._held)
        step = self.context.step
        progress = player.tick(step)
        if progress is Progress.MOVING:
            return Status.RUNNING
        if progress is Progress.STALLED:
            self._player = None
            error = step.tracking_error_rad
            return self.fail(FailureCode.STALLED, f"the arm is {error:.3f} rad behind its set-points", error_rad=error)
        status = self.on_arrived(self._motion)
        self._player = None
        return status

    def _has_lost(self, entity: str) -> bool:
        held = self.context.is_holding(entity)
        self._lost_periods = 0 if held else self._lost_periods + 1
        return self._lost_periods >= LOST_PERIODS


def _is_in(entity: Entity, vessel: Entity) -> bool:
    """Whether the origin of a movable entity lies in the interior of another."""
    if not entity.movable or vessel.interior is None or entity.name == vessel.name:
        return False
    world_T_vessel = compute_matrix(vessel.pose)
    point = world_T_vessel[:3, :3].T @ (np.array(entity.pose.position_m) - world_T_vessel[:3, 3])
    return bool(np.all(np.abs(point - vessel.interior.center_m) <= vessel.interior.half_m))
