"""Open and close the gripper at the speed of its drive."""

import numpy as np

from phyagentos.runtime.execution.leaf import Leaf, Port, PortInformation, Role, Status
from phyagentos.runtime.motion.requests import Approach

OPEN_TOLERANCE_M = 0.001  # a gripper this close to the wanted opening is open
SETTLE_S = 0.1  # after the drive has arrived
FIXED_PERIODS = 2  # commanded still, whatever the next report says, where the end is no nearer


class _GripperLeaf(Leaf):
    """Commands one width until the drive has arrived and its time to settle is over."""

    def begin(self, width_m: float, seconds: float | None, settle_s: float) -> Status:
        """Command `width_m` [m] for `seconds` [s] of simulated time; until the drive has arrived if that is None."""
        begun_s = self.context.time_s - 0.5 * self.context.profile.control_period_s
        squeeze_m, now_m = self.context.profile.gripper.squeeze_m, self.context.step.target.gripper_width_m
        self._from_m = min(max(self.context.commands.gripper_width_m, now_m - squeeze_m), now_m + squeeze_m)
        self._width_m, self._settle_s, self._begun_s = width_m, settle_s, begun_s
        self._until_s = begun_s + seconds if seconds is not None else None
        return self.on_running()

    def on_running(self) -> Status:
        """Command the width until time is up."""
        commands, now_s = self.context.commands, self.context.time_s
        if self._until_s is None and self._has_arrived(now_s):
            self._until_s = now_s + self._settle_s
        if self._until_s is None or now_s < self._until_s:
            soon_s = now_s + FIXED_PERIODS * self.context.profile.control_period_s
            commands.set_gripper(
                np.full(commands.n_steps, self._width_m),
                goes_on=soon_s < (now_s + self._settle_s if self._until_s is None else self._until_s),
            )
            return Status.RUNNING
        return self.on_settled(self.context.step.target.gripper_width_m)

    def _has_arrived(self, now_s: float) -> bool:
        """Whether the drive's own set-point is where it was sent, or as far in an object as its full force needs."""
        gripper, now_m = self.context.profile.gripper, self.context.step.target.gripper_width_m
        way_m = gripper.speed_m_s * (now_s - self._begun_s)
        is_closing = self._width_m < self._from_m
        return way_m >= abs(self._width_m - self._from_m) or (
            is_closing and now_m - (self._from_m - way_m) >= gripper.squeeze_m
        )

    def on_settled(self, width_m: float) -> Status:
        """The fingers stand still."""
        return self.succeed("", width_m=width_m)


class OpenGripper(_GripperLeaf):
    """Open the fingers; at once done when they are open."""

    ROLE = Role.OPEN
    INPUT_PORTS = {
        "width_m": Port(
            data_type=float, minimum=0.0, required=False, description="Opening [m]; as wide as it goes if unset."
        ),
        "approach": PortInformation(
            data_type=Approach, required=False, description="A place: its own opening, where it was planned for one."
        ),
        "seconds": Port(
            data_type=float,
            minimum=0.0,
            required=False,
            description="Time for it, simulated [s]; until they are open if unset.",
        ),
    }

    def on_start(self) -> Status:
        """Begin to open."""
        approach, widths = self.find("approach"), [self.find("width_m")]
        widths += [] if approach is None else [approach.release_m]
        self._fall_m = 0.0 if approach is None else approach.fall_m
        width_m = next((each for each in widths if each is not None), self.context.profile.gripper.max_width_m)
        now_m = self.context.step.target.gripper_width_m
        if abs(now_m - width_m) < OPEN_TOLERANCE_M and abs(self.context.commands.gripper_width_m - width_m) < 1e-9:
            return self.succeed("already open", width_m=now_m)
        return self.begin(width_m, self.find("seconds"), SETTLE_S)

    def on_settled(self, width_m: float) -> Status:
        """Report the width, and how far the planner let the object fall."""
        return self.succeed("", width_m=width_m, **({"fall_m": self._fall_m} if self._fall_m else {}))


class CloseGripper(_GripperLeaf):
    """Close the fingers onto whatever is between them, and report their opening."""

    ROLE = Role.GRASP
    INPUT_PORTS = {
        "seconds": Port(
            data_type=float,
            minimum=0.0,
            required=False,
            description="Time for it, simulated [s]; until they grip if unset.",
        )
    }
    OUTPUT_PORTS = {
        "width_m": PortInformation(data_type=float, required=False, description="Measured opening afterwards [m].")
    }

    def on_start(self) -> Status:
        """Begin to close."""
        return self.begin(0.0, self.find("seconds"), self.context.profile.gripper.close_time_s)

    def on_settled(self, width_m: float) -> Status:
        """Report the width."""
        self.write("width_m", width_m)
        return self.succeed("", width_m=width_m)
