"""Bases of leaves that plan and of leaves that move: request a motion, then play it."""

from typing import Any, ClassVar, Generic, TypeVar, cast, final

import numpy as np
from msgspec import to_builtins

from phyagentos.errors import format_names
from phyagentos.geometry import to_child
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.world.environment import Entity, Pose
from phyagentos.runtime.execution.leaf import FailureCode, Leaf, PortInformation, Role, Status
from phyagentos.runtime.execution.loads import measure_payload
from phyagentos.runtime.execution.trajectory_player import Progress, TrajectoryPlayer
from phyagentos.runtime.motion.requests import (
    Approach,
    Approaches,
    Array,
    FindLine,
    Motion,
    MotionAnswer,
    MotionRequest,
    Neighbour,
    NoPlan,
    Payload,
    PlanMove,
    PlanningState,
    World,
)
from phyagentos.runtime.perception.world_model import HAND
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.wire import Step

AnswerT = TypeVar("AnswerT", Approaches, Motion)
RequestT = TypeVar("RequestT", bound=PlanningState)
PRESSED_MORE = 1.2  # of the force of a contact that is about to be left
BESIDE = PortInformation(data_type=str, required=False, description="Robot to which the hand comes near on purpose.")
WAIT_S = 0.2  # for another robot that is in the way, until it is tried again
STOOD_MAX_S = 1.5  # of such waiting for one that stands, as no gripper does for so long, by the later in order of names
WAITED_MAX_S = 20.0  # in all, by any; a session of manipulation takes less
HOMEWARD = 0.45  # of the velocity limits: what is held stays in the fingers
LOST_PERIODS = 5  # 0.1 s without contact on both sides; single contacts flicker for a period or two
LOST_SHARE, LOST_M = 0.5, 0.004  # fingers that lost an object close by this share of their opening, at most by so much


class PlanningLeaf(Leaf, Generic[AnswerT]):
    """A leaf whose result is an answer of the planner.

    Authors write `compose` (what to ask) and `on_answer` (what to do with it). A request is composed once the arm
    rests, so that it begins where the arm really is. Requests of parallel leaves follow one another in tree order.
    """

    ROLE = Role.PLAN
    EXPECTED: ClassVar[type[MotionAnswer]] = Approaches  # the kind of answer that `on_answer` takes

    _is_asked = False
    _beside = ""  # a robot to which the hand comes near on purpose
    _waits_until_s, _waited_s, _stood_s = 0.0, 0.0, 0.0  # for another robot that is in the way
    _conflict = ""  # which robot was in the way for how long
    _gives_way = False  # it goes home, so that another robot can pass, and fails there

    def compose(self) -> MotionRequest | Status:
        """The request, or a status when none is needed."""
        raise NotImplementedError(f"{type(self).__name__} must define compose")

    def on_answer(self, answer: AnswerT) -> Status:
        """Use the answer; refusals (`NoPlan`) are handled before."""
        raise NotImplementedError(f"{type(self).__name__} must define on_answer")

    def on_refused(self, answer: NoPlan) -> Status:
        """FAILURE with the planner's own code."""
        return self.fail(answer.code, answer.message, rejected=answer.rejected)

    @final
    def on_start(self) -> Status:
        """Submit."""
        self._is_asked, self._gives_way, self._conflict = False, False, ""
        self._beside = self.find("beside") or "" if "beside" in self.INPUT_PORTS else ""
        self._waits_until_s, self._waited_s, self._stood_s = 0.0, 0.0, 0.0
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
        if isinstance(answer, NoPlan):
            return self.wait_for(answer.neighbours) if answer.neighbours else self.on_refused(answer)
        if not isinstance(answer, self.EXPECTED):
            wanted, found = self.EXPECTED.__name__, type(answer).__name__
            return self.fail(FailureCode.RUNNER_LOST, f"the planner answered {found}; expected {wanted}")
        return self.on_answer(cast("AnswerT", answer))

    def on_halted(self) -> None:
        """Cancel the request."""
        if self._is_asked:
            self.context.planner.cancel()
            self._is_asked = False

    def world(self) -> World:
        """The believed world for the planner; contents of a moved vessel move with it and are no obstacles."""
        environment = self.belief
        entities = environment.entities.values()
        moved = self.context.session.find_object(environment)
        vessels = [each for each in entities if each.interior is not None and (each.held_by or each.name == moved)]
        return World(
            entities=tuple(entity for entity in entities if not any(_is_in(entity, vessel) for vessel in vessels)),
            regions=tuple(environment.regions.values()),
            neighbours=tuple(self._describe(each) for each in self.context.cell.read_neighbours()),
        )

    def request(self, kind: type[RequestT], **fields: Any) -> RequestT:
        """A request from the believed world and the set-point as it stands, with a new seed; `fields` replace these."""
        posture = fields.pop("q_rad", self.context.commands.q_rad)
        return kind(world=self.world(), q_rad=posture, seed=self.context.draw_seed(self.path), **fields)

    def _describe(self, neighbour: wire.Neighbour) -> Neighbour:
        postures = np.vstack((neighbour.target.q_rad, neighbour.announced_rad))
        is_met = neighbour.name == self._beside
        return Neighbour(neighbour.name, postures, is_met)

    def find_held(self) -> Payload | None:
        """What the fingers hold as believed, so that a motion that was not composed for it carries it along."""
        holding = self.context.world.observe(HAND).targets[self.context.session.target].holding
        entities = self.belief.entities
        held = next((entities[name] for name in holding if name in entities), None)
        return None if held is None else measure_payload(held, self.context.step.target, self.context.profile)

    def choose_request(self) -> MotionRequest | Status:
        """What to ask now."""
        return self.compose()

    @final
    def wait_for(self, names: tuple[str, ...]) -> Status:
        """Hold still for a moment, then ask again; give up once these robots were in the way for too long."""
        there = [each for each in self.context.cell.read_neighbours() if each.name in names]
        is_first = all(self.context.session.target < each.name for each in there)
        if self._waited_s >= WAITED_MAX_S or (self._stood_s >= STOOD_MAX_S and not is_first):
            self._conflict = self._conflict or f"{format_names(names)} was in the way for {self._waited_s:.1f} s"
            return self.give_up()
        self._waits_until_s, self._waited_s = self.context.time_s + WAIT_S, self._waited_s + WAIT_S
        self._stood_s += 0.0 if any(len(each.announced_rad) for each in there) else WAIT_S
        return Status.RUNNING

    def give_up(self) -> Status:
        """FAILURE: another robot was in the way for too long."""
        return self.fail(FailureCode.MOTION_CONFLICT, self._conflict)

    @final
    def ask(self) -> Status:
        """Submit what `compose` gives, once the arm rests and the planner is free, and no other robot is waited for."""
        if self.context.time_s < self._waits_until_s:
            self.context.commands.hold()
            return Status.RUNNING
        if not (self.context.commands.at_rest and self.context.planner.is_free):
            return Status.RUNNING
        request = self.choose_request()
        if isinstance(request, Status):
            return request
        self.context.planner.submit(request)
        self._is_asked = True
        return Status.RUNNING


class ApproachPlanningLeaf(PlanningLeaf[Approaches]):
    """A leaf that requests approaches and writes them to the port `approaches`."""

    OUTPUT_PORTS = {
        "approaches": PortInformation(data_type=Approaches, description="Checked candidates, nearest first.")
    }

    @final
    def on_answer(self, answer: Approaches) -> Status:
        """Write the approaches, name the labels."""
        self.write("approaches", answer)
        return self.succeed("", labels=[approach.label for approach in answer.approaches])


class LinePlanningLeaf(PlanningLeaf[Approaches]):
    """A leaf that requests one straight way and writes it to the port `approach`."""

    OUTPUT_PORTS = {"approach": PortInformation(data_type=Approach, description="The path, from here to the end.")}

    def request_line(self, waypoints: tuple[Pose, ...]) -> FindLine:
        """A line from the present posture through tool poses, with the ports `payload` and `ignore`."""
        name = self.find("ignore")
        entity = self.belief.entities.get(name) if name is not None else None
        ignored = (name, *([entity.part_of] if entity is not None and entity.part_of else []))
        return self.request(
            FindLine,
            waypoints=waypoints,
            payload=self.find("payload"),
            ignore=() if name is None else ignored,  # what a handle belongs to moves with it
            width_m=self.context.step.target.gripper_width_m,
        )

    @final
    def on_answer(self, answer: Approaches) -> Status:
        """Write the way."""
        self.write("approach", answer.approaches[0])
        return self.succeed("", label=answer.approaches[0].label)


class CandidatePlanningLeaf(PlanningLeaf[Approaches]):
    """A leaf that requests one candidate after the other until the planner finds a way.

    Authors write `count_candidates`, `compose` for candidate number `tried`, and `on_found`, which may `ask` again.
    """

    tried = 0

    def count_candidates(self) -> int:
        """Number of candidates."""
        raise NotImplementedError(f"{type(self).__name__} must define count_candidates")

    def on_found(self, answer: Approaches) -> Status:
        """Use the way of candidate number `tried`."""
        raise NotImplementedError(f"{type(self).__name__} must define on_found")

    @final
    def on_refused(self, answer: NoPlan) -> Status:
        """Request the next candidate; the last one's refusal is the leaf's."""
        self.tried += 1
        if self.tried < self.count_candidates():
            return self.ask()
        self.tried = 0
        return super().on_refused(answer)

    @final
    def on_answer(self, answer: Approaches) -> Status:
        """Use the way; unless more is asked of the candidate, the next activation begins with the first one."""
        status = self.on_found(answer)
        self.tried = self.tried if status is Status.RUNNING else 0
        return status


class MovingLeaf(PlanningLeaf[Motion]):
    """A leaf that plays a timed motion.

    Authors write `compose` and, where wanted, `on_arrived`. Set `_held` to the name of an entity to fail with
    `GRASP_LOST` when it leaves the fingers on the way. Set `_stop_n` to a force [N] to fail with `CONTACT` when the
    target feels more; where the motion begins with more, that may last until it lets go, but not grow.
    """

    ROLE = Role.MOVE
    EXPECTED = Motion

    _player: TrajectoryPlayer | None = None
    _stop_n: float | None = None
    _pressed_n = 0.0  # allowed of the contact with which the motion began, as long as it lasts
    _held: str | None = None
    _lost_periods = 0
    _least_m = 0.0  # fingers that are open wider than this have not closed on nothing
    _judged: Step | None = None  # the latest step for which it was asked whether the entity is held

    def on_arrived(self, motion: Motion) -> Status:
        """The motion is complete."""
        return self.succeed("", **self.describe_motion(motion))

    @final
    def choose_request(self) -> MotionRequest | Status:
        """What the author composes, or the way home."""
        if not self._gives_way:
            return self.compose()
        home = np.asarray(self.context.profile.arm.home_rad, dtype=np.float64)
        return self.request_move(home[None, :], self.find_held(), HOMEWARD)

    @final
    def request_move(self, goals_rad: Array, payload: Payload | None, speed: float) -> PlanMove:
        """A motion through free space, from the present posture to one of `goals_rad` (k, n_joints)."""
        return self.request(
            PlanMove,
            goals_rad=goals_rad,
            payload=payload,
            speed=speed,
            width_m=self.context.step.target.gripper_width_m,
        )

    @final
    def give_up(self) -> Status:
        """Go home first, where that is possible, so that the other robot can pass; then fail."""
        if self._gives_way:
            return super().give_up()
        self._gives_way, self._waited_s, self._stood_s = True, 0.0, 0.0
        return self.ask()

    @final
    def on_answer(self, answer: Motion) -> Status:
        """Store the motion; it is played from this tick on."""
        context = self.context
        if blocking := context.cell.announce(answer.trajectory.q_rad, self._beside):
            return self.wait_for((blocking,))
        self._motion, self._lost_periods, self._judged = answer, 0, context.step
        self._pressed_n = PRESSED_MORE * (context.step.contact_force_n or 0.0)
        width_m = context.step.target.gripper_width_m
        self._least_m = width_m - min(LOST_SHARE * width_m, LOST_M)
        self._player = TrajectoryPlayer(answer.trajectory, context.commands, context.lag)
        return Status.RUNNING

    @final
    def on_running(self) -> Status:
        """Wait for the motion, then play it."""
        if self._player is None:
            waited = super().on_running()
            if self._player is None:
                return waited
        player, step = self._player, self.context.step
        if self._held is not None and step is not self._judged:
            self._judged = step
            stays_open = step.target.grip_force_n is not None and step.target.gripper_width_m > self._least_m
            is_there = stays_open or self.context.is_holding(self._held)
            self._lost_periods = 0 if is_there else self._lost_periods + 1
            if self._lost_periods >= LOST_PERIODS:
                self._player = None
                return self.fail(FailureCode.GRASP_LOST, f"{self._held} left the fingers", object=self._held)
        felt_n = step.contact_force_n
        if self._stop_n is not None and felt_n is not None:
            if felt_n <= self._stop_n:
                self._pressed_n = 0.0
            elif felt_n > self._pressed_n:
                self._player = None
                return self.fail(
                    FailureCode.CONTACT, f"a contact of {felt_n:.0f} N; up to {self._stop_n:g} N is allowed"
                )
        progress = player.tick(step)
        if progress is Progress.MOVING:
            return Status.RUNNING
        if progress is Progress.STALLED:
            self._player = None
            error = step.tracking_error_rad
            return self.fail(FailureCode.STALLED, f"the arm is {error:.3f} rad behind its set-points", error_rad=error)
        status = self.give_up() if self._gives_way else self.on_arrived(self._motion)
        self._player = None
        return status

    def on_halted(self) -> None:
        """Drop the request or the motion; the set-points brake by themselves."""
        self._player = None
        super().on_halted()

    @final
    def scale_speed(self, speed: float) -> float:
        """The wanted speed times the strategy's."""
        return speed * self.context.session.strategy.speed

    def describe_motion(self, motion: Motion) -> Fields:
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
            "worst_tracking_error_rad": self.context.lag.worst_error_rad,
        }


def _is_in(entity: Entity, vessel: Entity) -> bool:
    if not entity.movable or vessel.interior is None or entity.name == vessel.name:
        return False
    center, half = vessel.interior.center_m, vessel.interior.half_m
    return all(
        abs(x - c) <= h for x, c, h in zip(to_child(vessel.pose, entity.pose.position_m), center, half, strict=True)
    )
