"""Makes the simulated world misbehave, by physical means only: forces, friction, a seized joint. Never a state write.

Which fault becomes active, and when, follows from the seed and the simulated state alone. An activation carries
everything needed to be active again at the same moment, so the evidence of a session is enough to repeat it.
"""

import fnmatch
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.world.faults import (
    Blackout,
    Draw,
    Fault,
    FaultFile,
    Freeze,
    Miscalibrate,
    Misdate,
    Move,
    Nudge,
    Push,
    Remove,
    SensorFault,
    Slip,
    Stall,
    When,
)
from phyagentos.protocol.world.seeds import compute_seed
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.drivers.mujoco.robot_state import Array
from phyagentos.runtime.targets.wire import RecordedFault

LOOK_EVERY = 10  # physics steps between two looks at the conditions: one control period
SLIPPERY = (0.01, 0.0005, 0.0001)  # friction of pads while a grasp slips
SEIZED_NM = 1e4  # friction of a joint that does not turn
HAND_STIFFNESS, HAND_DAMPING, HAND_SPIN_DAMPING = 900.0, 60.0, 60.0  # 1/s^2, 1/s, 1/s: a firm hand, per unit of mass
HAND_HEIGHT_M = 0.14  # how high a person lifts
MOVE_RADIUS_M = (0.06, 0.12)  # how far a person moves an object when no place is given
CLEARANCE_M = 0.075
SENSOR_KINDS = frozenset({"freeze", "blackout", "misdate", "miscalibrate"})


class FaultActivation(msgspec.Struct, frozen=True, kw_only=True):
    """An active fault, of a kind of the fault file.

    Attributes:
        body: The object, the joint that seizes or whose link is pushed, or the pattern of the corrupted cameras.
        start_m: The object's place at the beginning; `goal_m` that at the end of a hand's pull, `lift_m` its height.
        mode: Of a corruption: stamp of a frozen picture, or kind of a blackout.
        by_s: Error of a camera's clock; `by_m` and `by_rad` of its reported pose.
        qpos: The state of a frozen picture.
        force_n: Of a push, in the world.
    """

    kind: str
    body: str
    time_s: float
    duration_s: float
    start_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    goal_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lift_m: float = 0.0
    mode: str = ""
    by_s: float = 0.0
    by_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    by_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    qpos: tuple[float, ...] = ()
    force_n: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Schedule:
    """The faults of one episode, each at most once by its conditions, and recorded ones, each at its recorded time."""

    faults: tuple[Fault, ...] = ()
    activations: tuple[FaultActivation, ...] = ()
    seed: int = 0


def draw_schedule(file: FaultFile, episode: str, seed: int) -> Schedule:
    """The faults of one episode."""
    root = compute_seed(seed, "faults", episode)
    drawn = (draw_fault(file.draw, root),) if file.draw is not None else ()
    return Schedule((*file.faults, *drawn), (), root)


def draw_fault(draw: Draw, seed: int) -> Fault:
    """One fault of the drawn kind for the drawn object."""
    rng = np.random.default_rng(compute_seed(seed, "draw"))
    kind = draw.one_of[int(rng.integers(len(draw.one_of)))]
    name = draw.objects[int(rng.integers(len(draw.objects)))]
    kinds: dict[str, type[Slip | Nudge | Move | Stall]] = {"slip": Slip, "nudge": Nudge, "move": Move, "stall": Stall}
    return kinds[kind].model_validate({"kind": kind, "object": name})


def read_activations(records: Sequence[RecordedFault]) -> Schedule:
    """The schedule that repeats the records of a bundle's `faults.json`."""
    return Schedule((), tuple(msgspec.convert(record.details, FaultActivation) for record in records), 0)


class FaultInjector:
    """The faults of one episode, as they act on one robot and its objects."""

    def __init__(self, schedule: Schedule = Schedule()) -> None:
        self._waiting = list(schedule.faults)
        self._recorded = list(schedule.activations)
        self._rng = np.random.default_rng(schedule.seed)
        self._active: list[FaultActivation] = []
        self._session = ""
        self._heights_m: dict[str, float] = {}
        self._steps = 0
        self._all = [self]

    def fork(self) -> "FaultInjector":
        """For another robot of the same world; each fault becomes active on one robot only."""
        other = FaultInjector()
        other._waiting, other._recorded, other._rng, other._all = self._waiting, self._recorded, self._rng, self._all
        self._all.append(other)
        return other

    def on_session(self, session: str) -> tuple[RecordedFault, ...]:
        """Begin a session; returns faults that are still active."""
        self._session, self._heights_m = session, {}
        return tuple(_report(activation) for activation in self._active)

    @property
    def is_idle(self) -> bool:
        """Whether there is no fault, now or later."""
        return not (self._waiting or self._recorded or self._active)

    def act(self, physics: Physics) -> list[RecordedFault]:
        """Before every physics step: activate due faults, and apply active ones."""
        if self.is_idle:
            return []
        due = self._steps % LOOK_EVERY == 0
        self._steps += 1
        begun = [self._begin(physics, self._resolve(physics, each)) for each in self._find_due(physics)] if due else []
        begun += self._repeat(physics)
        for activation in list(self._active):
            if physics.time_s >= activation.time_s + activation.duration_s:
                self._active.remove(activation)
                _switch(physics, activation, on=False)
            elif activation.goal_m != activation.start_m:
                _carry(physics, activation)
        return [_report(activation) for activation in begun]

    def find_sensor_corruption(self, camera: str) -> tuple[FaultActivation, ...]:
        """Active faults of a camera."""
        active = (each for injector in self._all for each in injector._active)
        return tuple(s for s in active if s.kind in SENSOR_KINDS and fnmatch.fnmatchcase(camera, s.body))

    def _find_due(self, physics: Physics) -> list[Fault]:
        due = [fault for fault in self._waiting if self._holds(physics, fault.when, fault.object)]
        for fault in due:
            self._waiting.remove(fault)
        return due

    def _holds(self, physics: Physics, when: When, name: str) -> bool:
        if when.time_s is not None and physics.time_s < when.time_s:
            return False
        if when.session is not None and not fnmatch.fnmatchcase(self._session, when.session):
            return False
        if when.lifted_m is None and when.gripper_near_m is None:
            return bool(self._session)
        if not name or not self._session:
            return False
        position = physics.queries.find_position(name)
        base_m = self._heights_m.setdefault(name, float(position[2]))
        if when.lifted_m is not None and not (physics.queries.is_held(name) and position[2] - base_m >= when.lifted_m):
            return False
        near = when.gripper_near_m
        return near is None or bool(np.linalg.norm(physics.queries.find_tcp()[0] - position) <= near)

    def _repeat(self, physics: Physics) -> list[FaultActivation]:
        due = [activation for activation in self._recorded if physics.time_s >= activation.time_s - 1e-9]
        for activation in due:
            self._recorded.remove(activation)
            self._begin(physics, activation)
        return due

    def _begin(self, physics: Physics, activation: FaultActivation) -> FaultActivation:
        self._active.append(activation)
        _switch(physics, activation, on=True)
        return activation

    def _resolve(self, physics: Physics, fault: Fault) -> FaultActivation:
        """Draw all open parameters of a fault."""
        begun = FaultActivation(
            kind=fault.kind, body=_find_body(fault), time_s=physics.time_s, duration_s=fault.duration_s
        )
        match fault:
            case Stall():
                return begun
            case Push():
                angle = self._rng.uniform(0, 2 * np.pi) if fault.direction_rad is None else fault.direction_rad
                force_n = fault.force_n * np.array([np.cos(angle), np.sin(angle), 0.0])
                return msgspec.structs.replace(begun, force_n=_as_tuple(force_n))
            case Freeze():
                return msgspec.structs.replace(begun, mode=fault.stamp, qpos=tuple(physics.data.qpos.tolist()))
            case Blackout():
                return msgspec.structs.replace(begun, mode=fault.mode)
            case Misdate():
                return msgspec.structs.replace(begun, by_s=fault.by_s)
            case Miscalibrate():
                return msgspec.structs.replace(begun, by_m=fault.by_m, by_rad=fault.by_rad)
        start = physics.queries.find_position(fault.object)
        goal, lift = start, 0.0
        match fault:
            case Nudge():
                goal = start + self._choose_nudge(physics, start, fault.by_m)
            case Move():
                goal, lift = self._choose_place(physics, fault, start), HAND_HEIGHT_M
            case Remove():
                goal, lift = np.array([*fault.to_m, start[2]]), HAND_HEIGHT_M
        return msgspec.structs.replace(begun, start_m=_as_tuple(start), goal_m=_as_tuple(goal), lift_m=lift)

    def _choose_nudge(self, physics: Physics, start: Array, by_m: float) -> Array:
        """Between the fingers and out: along the axis that is neither approach nor closing, to the emptier side."""
        axis = physics.queries.find_tcp()[1][:, 0] * np.array([1.0, 1.0, 0.0])
        axis /= np.linalg.norm(axis)
        sides = (axis * by_m, -axis * by_m)
        return max(sides, key=lambda side: physics.queries.find_clearance(start + side, start))

    def _choose_place(self, physics: Physics, fault: Move, start: Array) -> Array:
        if fault.to_m is not None:
            return np.array([*fault.to_m, start[2]])
        places = []
        for _ in range(64):
            angle, radius = self._rng.uniform(0, 2 * np.pi), self._rng.uniform(*MOVE_RADIUS_M)
            place = start + radius * np.array([np.cos(angle), np.sin(angle), 0.0])
            if physics.queries.find_clearance(place, start) >= CLEARANCE_M and physics.queries.can_grasp_at(place):
                return place
            places.append(place)
        return max(places, key=lambda place: physics.queries.find_clearance(place, start))


def _find_body(fault: Fault) -> str:
    """What a fault strikes: the joint, the pattern of cameras, or the object."""
    if isinstance(fault, Stall | Push):
        return fault.joint
    return fault.camera if isinstance(fault, SensorFault) else fault.object


def _carry(physics: Physics, activation: FaultActivation) -> None:
    """Pull the body along its way with a hand's force: up, across, down."""
    phase = (physics.time_s - activation.time_s) / activation.duration_s
    start, goal = np.array(activation.start_m), np.array(activation.goal_m)
    across = np.clip((phase - 0.25) / 0.5, 0.0, 1.0) if activation.lift_m else np.clip(phase / 0.8, 0.0, 1.0)
    smooth = across * across * (3 - 2 * across)
    height = activation.lift_m * np.clip(min(phase, 1.0 - phase) / 0.25, 0.0, 1.0)
    physics.actuation.pull(
        activation.body,
        wanted=start + smooth * (goal - start) + np.array([0.0, 0.0, height]),
        stiffness=HAND_STIFFNESS,
        damping=HAND_DAMPING,
        spin_damping=HAND_SPIN_DAMPING,
        carries_weight=activation.lift_m > 0.0,
    )


def _switch(physics: Physics, activation: FaultActivation, *, on: bool) -> None:
    """Begin or end what acts by itself; a hand pulls at every step, and lets go at the end."""
    match activation.kind:
        case "slip":
            physics.actuation.set_pad_friction(SLIPPERY if on else None)
        case "stall":
            physics.actuation.set_joint_friction(activation.body, SEIZED_NM if on else None)
        case "push":
            physics.actuation.push(activation.body, np.array(activation.force_n) if on else np.zeros(3))
        case kind if not on and kind not in SENSOR_KINDS:
            physics.actuation.let_go(activation.body)


def _report(activation: FaultActivation) -> RecordedFault:
    details: Fields = msgspec.to_builtins(activation)
    return RecordedFault(kind=activation.kind, time_s=activation.time_s, details=details)


def _as_tuple(point: Array) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in point)
    return (x, y, z)
