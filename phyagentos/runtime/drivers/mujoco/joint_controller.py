"""The joint controller of one robot: follows set-points, comes to rest by itself, and stops on a collision.

Decelerations to a hold and protective stops are no commands and need no authority. Each motion is a generator that
yields once before every physics step, so that several robots move under one time.
"""

from collections import deque
from collections.abc import Generator
from typing import TYPE_CHECKING

import numpy as np

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.drivers.mujoco.joint_sensors import ForceEstimate
from phyagentos.runtime.drivers.mujoco.local_limits import LocalLimits, SetPoint
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.drivers.mujoco.robot_state import Array
from phyagentos.runtime.drivers.mujoco.stride import NO_STRIDE, Stride, Strider
from phyagentos.runtime.targets.wire import Command, RecordedFault, Refused

if TYPE_CHECKING:
    from phyagentos.runtime.drivers.mujoco.faults import FaultInjector

Motion = Generator[None, None, str]
"""Physics steps of one robot; returns the code of the stop that broke it off, empty when it was carried out."""

HISTORY_S = 1.5  # more than the latest camera allowed, with a run of lost frames
HALT_MAX_S = 2.0  # longest deceleration to a hold
REST_RAD_S = 0.01  # every joint slower than this is at rest
STANDING_SHARE = 1.2  # of a force that stood when a session began: more is a command that presses harder


class StateHistory:
    """Joint positions at past moments.

    It begins anew with each session: the frames of a session follow from its own beginning, and it can be repeated.
    """

    def __init__(self) -> None:
        self._states: deque[tuple[float, Array]] = deque()

    def begin(self, time_s: float, qpos: Array) -> None:
        """Forget the past; this is the first moment."""
        self._states.clear()
        self.note(time_s, qpos)

    def copy(self) -> "StateHistory":
        """The same moments, to read while time passes."""
        copied = StateHistory()
        copied._states.extend(self._states)
        return copied

    def note(self, time_s: float, qpos: Array) -> None:
        """Keep the joint positions (nq,) of a moment."""
        self._states.append((time_s, qpos.copy()))
        while self._states[0][0] < time_s - HISTORY_S:
            self._states.popleft()

    def find(self, time_s: float) -> tuple[float, Array]:
        """The latest moment up to `time_s`, and its joint positions (nq,); the first one when all are later."""
        return next((each for each in reversed(self._states) if each[0] <= time_s + 1e-9), self._states[0])

    def interpolate(self, time_s: float) -> Array:
        """(nq,) joint positions at a moment between two that are kept; turns of free bodies need not have length 1."""
        later = self._states[-1]
        for moment in reversed(self._states):
            if moment[0] <= time_s:
                share = (time_s - moment[0]) / max(later[0] - moment[0], 1e-9)
                return moment[1] + min(share, 1.0) * (later[1] - moment[1])
            later = moment
        return later[1]


class JointController:
    """Set-points, servos and stops, for commands of `n_steps` rows.

    `activations` are faults that became active since this was emptied; `history` has states since the session began.
    """

    def __init__(self, profile: TargetProfile, physics: Physics, faults: "FaultInjector", n_steps: int) -> None:
        self._profile, self._physics, self._faults = profile, physics, faults
        self._limits = LocalLimits(profile, physics, n_steps)
        self._held = SetPoint.at_rest(np.array(profile.arm.home_rad))
        self._width_m = profile.gripper.max_width_m
        self._estimate = ForceEstimate(profile, physics.scene.seed, profile.physics_step_s)
        self._force_n = self._force_max_n = 0.0  # of the latest physics step, and since the last report
        self._standing_n = 0.0  # force in which the session began; falls with it, and never rises
        self.activations: list[RecordedFault] = []
        self.history = StateHistory()
        self._n_steps, self._steps = n_steps, 0
        self._strider = Strider(physics, self._limits) if physics.state.base is None else None
        self._begin_history()

    @property
    def q_rad(self) -> Array:
        """(n_joints,) the set-point that is held."""
        return self._held.q_rad

    @property
    def force_error_n(self) -> float:
        """Greatest expected error of a contact force [N]."""
        return self._estimate.error_n

    @property
    def is_moving(self) -> bool:
        """Whether the set-points stopped in the middle of a motion."""
        return bool(self._held.qd_rad_s.any())

    def hold(self, q_rad: Array) -> None:
        """Take a posture as the set-point, at rest, the fingers stay; after a scene was loaded."""
        self._held = SetPoint.at_rest(np.clip(q_rad, self._limits.low, self._limits.high))
        self._width_m = self._physics.actuation.commanded_width_m

    def begin(self) -> None:
        """Begin a session: set-points continue from the measured posture, at rest.

        An arm that rests in contact beyond its limit may leave it: until the force has fallen below the limit, only a
        greater force than the one that stands is a collision.
        """
        self._held = SetPoint.at_rest(np.clip(self._physics.state.q_rad, self._limits.low, self._limits.high))
        self._force_max_n = 0.0
        self._standing_n = self._force_n
        self._physics.actuation.begin()
        self._begin_history()

    def _begin_history(self) -> None:
        self._steps = 0
        self.history.begin(self._physics.time_s, self._physics.data.qpos)

    def check(self, command: Command) -> Refused | None:
        """Refusal of a command by the target's own limits."""
        return self._limits.check(command, self._held)

    def follow(self, command: Command, *, is_alone: bool = False) -> Motion:
        """Carry out one command, which `check` did not refuse; without a yield where it `is_alone` in its world."""
        physics = self._physics
        widths = self._limit_fingers(command.gripper_width_m)
        controls = physics.actuation.compute_controls(command.q_rad, command.qd_rad_s, widths)
        self._width_m, row = float(widths[-1]), 0
        while row < len(controls):
            stride = self._stride(controls[row:]) if is_alone else NO_STRIDE
            row += stride.steps
            if stride.is_felt:
                self._feel()
            elif not stride.steps:
                physics.data.ctrl[physics.actuation.inputs] = controls[row]
                physics.actuation.lead_base(command.q_rad[row], command.qd_rad_s[row])
                yield from self._step()
                row += 1
            if self._force_n > max(self._profile.contact_force_n, STANDING_SHARE * self._standing_n):
                yield from self.halt()
                return "COLLISION_STOP"
        last = command.q_rad[-2] if len(command.q_rad) > 1 else self._held.q_rad
        self._held = SetPoint(command.q_rad[-1], command.qd_rad_s[-1], command.q_rad[-1] - last)
        if self._limits.find_excess():
            yield from self.halt()
            return "PROTECTIVE_STOP"
        return ""

    def _limit_fingers(self, width_m: Array) -> Array:
        """The drive's set-points (n,) on its way to commanded openings (n,) [m].

        It moves at its own speed, and never farther into an object than its full force needs.
        """
        if not np.count_nonzero(width_m != self._width_m):
            return width_m
        gripper, measured = self._profile.gripper, self._physics.state.gripper_width_m
        now = min(max(self._width_m, measured - gripper.squeeze_m), measured + gripper.squeeze_m)
        step, reached = gripper.speed_m_s * self._profile.physics_step_s, []
        for wanted in width_m.tolist():
            now += min(max(wanted - now, -step), step)
            reached.append(now)
        return np.array(reached)

    def halt(self) -> Motion:
        """Decelerate within the joint limits, all joints in proportion, then hold."""
        physics, dt = self._physics, self._profile.physics_step_s
        q, moving = physics.state.measure_joints()
        braking = min(int(np.ceil(self._limits.compute_stop_s(moving) / dt)), round(HALT_MAX_S / dt))
        for step in range(1, round(HALT_MAX_S / dt) + 1):
            qd = moving * max(1.0 - step / max(braking, 1), 0.0)
            q = np.clip(q + qd * dt, self._limits.low, self._limits.high)
            physics.actuation.set_servos(q, qd, self._width_m)
            yield from self._step()
            if self._force_n > self._profile.contact_force_n:  # whatever is pressed is not pressed on
                q, moving = physics.state.q_rad, np.zeros_like(q)
            if step >= braking and np.abs(physics.state.qd_rad_s).max() < REST_RAD_S:
                break
        self._held = SetPoint.at_rest(q)
        return ""

    def settle(self, duration_s: float, *, is_alone: bool = False) -> Motion:
        """Come to rest, and hold still for some simulated time [s]; `is_alone` as of `follow`."""
        if self.is_moving:
            yield from self.halt()
        left, rest = round(duration_s / self._profile.physics_step_s), np.zeros((1, len(self.q_rad)))
        held = self._physics.actuation.compute_controls(self.q_rad[None], rest, np.array([self._width_m]))
        controls = np.repeat(held, left, axis=0)
        while left:
            stride = self._stride(controls[:left]) if is_alone else NO_STRIDE
            if stride.is_felt:
                self._feel()
            elif not stride.steps:
                yield from self._hold_step()
            left -= stride.steps or 1
        return ""

    def stand(self) -> Motion:
        """Come to rest and hold for as long as time passes; never returns."""
        if self.is_moving:
            yield from self.halt()
        while True:
            yield from self._hold_step()

    def take_force(self) -> float:
        """The greatest estimated contact force [N] since the last call; contacts that load no joint are ignored."""
        taken, self._force_max_n = self._force_max_n, 0.0
        return taken

    def _hold_step(self) -> Generator[None, None, None]:
        self._physics.actuation.set_servos(self.q_rad, np.zeros_like(self.q_rad), self._width_m)
        yield from self._step()

    def _step(self) -> Generator[None, None, None]:
        self._prepare()
        yield
        self._sense()

    def _stride(self, controls: Array) -> Stride:
        """Physics steps with these servo inputs (n, n_inputs), as `_step` takes them, up to one that is felt."""
        if self._strider is None or not self._faults.is_idle:
            return NO_STRIDE
        stride = self._strider.take(controls[: self._n_steps - self._steps % self._n_steps])
        if stride.steps > stride.is_felt:
            self._force_n = self._standing_n = 0.0
        self._note_steps(stride.steps)
        return stride

    def _prepare(self) -> None:
        """Before a physics step: drive the base, limit the servo inputs and let faults act."""
        self._physics.actuation.drive()
        self._limits.restrain()
        self.activations += self._faults.act(self._physics)

    def _sense(self) -> None:
        """After it: record force and state."""
        self._feel()
        self._note_steps(1)

    def _note_steps(self, count: int) -> None:
        self._steps += count
        if self._steps % self._n_steps == 0:
            self.history.note(self._physics.time_s, self._physics.data.qpos)

    def _feel(self) -> None:
        physics = self._physics
        self._force_n = 0.0
        if physics.state.base is not None or self._estimate.is_felt(
            physics.data.qfrc_constraint[physics.state.v_address]
        ):
            self._force_n = self._estimate.measure(physics.queries.find_hardest_contact()[0], physics.time_s)
        self._force_max_n = max(self._force_max_n, self._force_n)
        self._standing_n = min(self._standing_n, self._force_n)
