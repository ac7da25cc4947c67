"""The target's own limits, whatever commands it: which set-points it takes, and how its drives may push.

Set-points that no drive should follow are refused. Each physics step's servo input is kept so that no joint exceeds
its velocity or runs into its end. For commands within the limits the servo input is untouched, bit for bit.
"""

from dataclasses import dataclass

import numpy as np

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.drivers.mujoco.robot_state import Array
from phyagentos.runtime.targets.wire import Command, Refused

SET_POINT_SHARE = 0.94  # of the velocity limit, for set-points; skills use 0.9
SPEED_SHARE = 0.95  # of the velocity limit, for the drives; the rest is for what other joints push
END_MARGIN_RAD = 0.01  # before the end of a range: a servo overshoots by a milliradian, a contact presses by five
WORKSPACE_MARGIN_M = 0.02  # the way of a tool between two looks is bent, and a servo lags by some millimetres
BRAKING_SHARE = 0.8  # of the acceleration limit, for the drives' own deceleration: the torque for it is always there
FORESIGHT_SHARE = 0.65  # of the acceleration limit, for where the arm is assumed to come to rest; less than it brakes
FAST_RAD = 0.05  # of a braking way: two to four centimetres at the tool, thinner than anything it could pass through
LOOKS_SLOW, LOOKS_FAST = (1.0,), (1.0, 0.5, 0.0)  # shares of the braking way at which the arm's posture is checked
CHANGE_TOLERANCE = 0.15  # of two velocity rows against the acceleration limit; a little more than the guard's
BEND_TOLERANCE = 0.30  # of second differences of position rows
ROUNDING = 1e-6
TOLD_STDS = 6.0  # of the encoders' noise: by so much a resting arm's reported posture may differ from the one it holds


BROKEN = (  # what is measured of every row, in this order
    "a set-point leaves the range of its joint",
    "a set-point leaves the range of its joint",
    "set-points move or jump faster than the joints may",
    "set-points move or jump faster than the joints may",
    "positions change faster than the joints may accelerate",
    "velocities change faster than the joints may accelerate",
    "the velocities are not those of the positions",
)


@dataclass(frozen=True, slots=True)
class SetPoint:
    """The last set-point of the servos, (n_joints,) each; `step_rad` is the difference to the position before."""

    q_rad: Array
    qd_rad_s: Array
    step_rad: Array

    @classmethod
    def at_rest(cls, q_rad: Array) -> "SetPoint":
        """Standing at `q_rad`."""
        return cls(q_rad, np.zeros_like(q_rad), np.zeros_like(q_rad))


class LocalLimits:
    """Limits of one target in one scene, for commands of `n_steps` rows."""

    def __init__(self, profile: TargetProfile, physics: Physics, n_steps: int) -> None:
        arm, dt = profile.arm, profile.physics_step_s
        self._physics, self._width_max_m = physics, profile.gripper.max_width_m
        self._shape = (n_steps, len(arm.joints))
        self._dt = dt
        self._found, self._before = np.zeros((len(BROKEN), *self._shape)), np.zeros((3, *self._shape))
        self._velocity = np.array(arm.velocity_rad_s)
        self._told_rad = TOLD_STDS * arm.position_noise_rad
        self._brake = np.array(arm.acceleration_rad_s2)
        self._lead_s = physics.actuation.lead_s
        self.low, self.high = physics.state.q_range[0] + END_MARGIN_RAD, physics.state.q_range[1] - END_MARGIN_RAD
        own = self._servoed = profile.servoed
        self._top, braking = SPEED_SHARE * self._velocity[own], self._brake[own]
        low, high = self.low[own], self.high[own]
        self.middle = 0.5 * (low + high)
        room = 0.5 * (high - low) - self._top**2 / (2.0 * braking)
        self.free = self._lead_s * self._top, room  # of an input from its joint, and of that from its middle [rad]
        self._box = np.array(profile.workspace_m) if profile.workspace_m is not None else None
        top, a_dt, none = SET_POINT_SHARE * self._velocity, self._brake * dt, np.zeros(len(arm.joints))
        change = (1.0 + CHANGE_TOLERANCE) * a_dt
        bend = (1.0 + BEND_TOLERANCE) * a_dt * dt
        self._bounds = np.array((none, none, top, top * dt, bend, change, change * dt))[:, None]

    def check(self, command: Command, held: SetPoint) -> Refused | None:
        """Refusal of a command that cannot be followed from the held set-point within the limits."""
        q, qd, width = command.q_rad, command.qd_rad_s, command.gripper_width_m
        if (q.shape, qd.shape, width.shape) != (self._shape, self._shape, self._shape[:1]):
            rows, n = self._shape
            return Refused("MALFORMED", f"shapes {q.shape}, {qd.shape}, {width.shape}; expected {rows} rows of {n}")
        if any(array.dtype != np.float64 for array in (q, qd, width)):
            return Refused("MALFORMED", "set-points are float64")
        broken = self._find_broken(q, qd, held)
        if broken and self._departs_nearby(q[0], qd[0], held):
            broken = self._find_broken(q, qd, SetPoint.at_rest(q[0] - 0.5 * self._dt * qd[0]))
        is_width_allowed = all(-ROUNDING <= each <= self._width_max_m + ROUNDING for each in width.tolist())
        if (broken or not is_width_allowed) and not all(np.isfinite(array).all() for array in (q, qd, width)):
            return Refused("MALFORMED", "a set-point is not finite")
        if broken:
            return Refused("TARGET_LIMIT", broken)
        if not is_width_allowed:
            return Refused("TARGET_LIMIT", f"opening outside 0..{self._width_max_m} m")
        return self._check_place(q[-1], qd[-1])

    def _departs_nearby(self, q: Array, qd: Array, held: SetPoint) -> bool:
        """Whether a first row departs from rest where the encoders may have shown its sender an arm at rest.

        An arm that is pressed aside stands beside what it holds.
        """
        if not self._told_rad or held.qd_rad_s.any():
            return False
        with np.errstate(invalid="ignore", over="ignore"):
            away = np.abs(q - 0.5 * self._dt * qd - (held.q_rad, self._physics.state.q_rad)).max(axis=1)
        return bool(away.min() <= self._told_rad)

    def _find_broken(self, q: Array, qd: Array, held: SetPoint) -> str:
        """The broken bound, empty for none: one comparison for all bounds, sudden changes of one joint included."""
        found, (q_before, qd_before, step_before), dt = self._found, self._before, self._dt
        with np.errstate(invalid="ignore", over="ignore"):
            q_before[0], q_before[1:] = held.q_rad, q[:-1]
            qd_before[0], qd_before[1:] = held.qd_rad_s, qd[:-1]
            now = q - q_before
            step_before[0], step_before[1:] = held.step_rad, now[:-1]
            found[0], found[1], found[2], found[3] = self.low - q, q - self.high, qd, now
            found[4], found[5] = now - step_before, qd - qd_before
            found[6] = now - 0.5 * (qd + qd_before) * dt
            np.abs(found[2:], out=found[2:])
            is_within = found <= self._bounds
        if np.count_nonzero(is_within) == is_within.size:
            return ""
        return BROKEN[int(np.argmin(is_within.all(axis=(1, 2))))]

    def _check_place(self, q: Array, qd: Array) -> Refused | None:
        """Refuse a resting place in collision or outside of the workspace.

        All joints are assumed to brake in proportion: braking each for itself was rejected, since it bends the way.
        """
        way = 0.5 * self.compute_stop_s(qd, FORESIGHT_SHARE) * qd
        looks = LOOKS_FAST if np.count_nonzero(np.abs(way) > FAST_RAD) else LOOKS_SLOW
        for share in looks:
            posture = np.minimum(np.maximum(q + share * way, self.low), self.high)
            tcp, contact = self._physics.queries.check_posture(posture)
            if contact:
                return Refused("TARGET_LIMIT", f"the arm would run into something: {contact}")
            if self._box is None:
                continue
            low, high = self._box[0] + WORKSPACE_MARGIN_M, self._box[1] - WORKSPACE_MARGIN_M
            if np.count_nonzero(tcp < low) or np.count_nonzero(tcp > high):
                return Refused("TARGET_LIMIT", f"the tool would leave the workspace, at {np.round(tcp, 3).tolist()} m")
        return None

    def compute_stop_s(self, qd_rad_s: Array, share: float = BRAKING_SHARE) -> float:
        """Time to bring these velocities to zero, all in proportion, by this share of the joints' deceleration."""
        return float((np.abs(qd_rad_s) / (share * self._brake)).max())

    def restrain(self) -> None:
        """Bound the servo inputs of the coming physics step.

        A servo with gains kp and kv settles at the velocity w = (ctrl - q) kp / kv. That is bounded by the joint's
        velocity limit, and by sqrt(2 a d) at a distance d from the end of its range, a being its braking deceleration.
        """
        data, servos = self._physics.data, self._physics.actuation.servos
        q, wanted = data.qpos[self._physics.state.q_address], data.ctrl[servos]
        step, room = self.free
        if (np.abs(wanted - q) <= step).all() and (np.abs(q - self.middle) <= room).all():
            return
        low, high, braking = self.low[self._servoed], self.high[self._servoed], self._brake[self._servoed]
        up = np.minimum(self._top, np.sqrt(2.0 * braking * np.maximum(high - q, 0.0)))
        down = np.minimum(self._top, np.sqrt(2.0 * braking * np.maximum(q - low, 0.0)))
        data.ctrl[servos] = np.clip(wanted, q - self._lead_s * down, q + self._lead_s * up)

    def find_excess(self) -> str:
        """The limit that the measured state breaks; empty for none."""
        physics = self._physics
        q, qd = physics.state.measure_joints()
        if np.count_nonzero(np.abs(qd) > self._velocity + physics.actuation.sway):
            return "a joint is faster than its limit"
        if np.count_nonzero(q < physics.state.q_range[0]) or np.count_nonzero(q > physics.state.q_range[1]):
            return "a joint is outside its range"
        if self._box is not None:
            tcp = physics.queries.find_tcp()[0]
            if np.count_nonzero(tcp < self._box[0]) or np.count_nonzero(tcp > self._box[1]):
                return "the tool is outside the workspace"
        return ""
