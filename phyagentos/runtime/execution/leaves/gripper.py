"""Open and close the gripper: commanded widths, and a fixed time for the fingers to settle."""

import math

import numpy as np

from phyagentos.runtime.execution.leaf import Leaf, PortInformation, Role, Status
from phyagentos.runtime.motion.requests import Approach

OPEN_TOLERANCE_M = 0.001  # a gripper this close to the wanted opening is open
CLOSING_M_S = 0.25  # of the opening: both fingers hang on one drive, and at full speed the first to touch is a blow


class _GripperLeaf(Leaf):
    """Commands one width for so many seconds of simulated time."""

    _until_s = 0.0
    _speed_m_s = math.inf

    def begin(self, width_m: float, duration_s: float) -> Status:
        """Command `width_m` [m] for `duration_s` [s]."""
        self._width_m = width_m
        self._until_s = self.context.time_s + duration_s - 0.5 * self.context.profile.control_period_s
        return self.on_running()

    def on_running(self) -> Status:
        """Command the width until time is up."""
        commands = self.context.commands
        if self.context.time_s < self._until_s:
            step_m = self._speed_m_s * self.context.profile.physics_step_s
            now_m = commands.gripper_width_m
            way = now_m - step_m * np.arange(1, commands.n_steps + 1) if math.isfinite(step_m) else self._width_m
            commands.set_gripper(np.maximum(np.full(commands.n_steps, self._width_m), way))
            return Status.RUNNING
        return self.on_settled(self.context.step.target.gripper_width_m)

    def on_settled(self, width_m: float) -> Status:
        """The fingers stand still."""
        return self.succeed("", width_m=width_m)


class OpenGripper(_GripperLeaf):
    """Open the fingers; at once done when they are open."""

    ROLE = Role.OPEN
    INPUT_PORTS = {
        "width_m": PortInformation(
            data_type=float, required=False, description="Opening [m]; as wide as it goes if unset."
        ),
        "approach": PortInformation(
            data_type=Approach, required=False, description="A place: its own opening, where it was planned for one."
        ),
        "seconds": PortInformation(data_type=float, default_value=0.3, description="Time for it, simulated [s]."),
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
        return self.begin(width_m, self.read("seconds"))

    def on_settled(self, width_m: float) -> Status:
        """Report the width, and how far the planner let the thing fall."""
        return self.succeed("", width_m=width_m, **({"fall_m": self._fall_m} if self._fall_m else {}))


class CloseGripper(_GripperLeaf):
    """Close the fingers onto whatever is between them, and report their opening."""

    _speed_m_s = CLOSING_M_S

    ROLE = Role.GRASP
    INPUT_PORTS = {
        "seconds": PortInformation(
            data_type=float, required=False, description="Time for it, simulated [s]; the target's own if unset."
        ),
    }
    OUTPUT_PORTS = {
        "width_m": PortInformation(data_type=float, required=False, description="Measured opening afterwards [m].")
    }

    def on_start(self) -> Status:
        """Begin to close."""
        seconds = self.find("seconds")
        return self.begin(0.0, self.context.profile.gripper.close_time_s if seconds is None else seconds)

    def on_settled(self, width_m: float) -> Status:
        """Report the width."""
        self.write("width_m", width_m)
        return self.succeed("", width_m=width_m)
