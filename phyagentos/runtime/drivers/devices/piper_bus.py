"""The CAN bus of an AgileX PIPER: protocol V2 of `piper_sdk`, joints and gripper in position mode (MOVE J).

The package logs a frame that could not be sent and goes on, so a lost bus shows as feedback that stays away. Ending an
emergency stop (0x150, 2) takes the power from the drives and lets the arm fall: that is left to a person.
"""

import math
from types import ModuleType
from typing import Any

import numpy as np
import pydantic
from typing_extensions import override

from phyagentos.clock import Clock
from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.drivers.devices.device_driver import Array, Bus, DeviceSettings, Reading

MILLIDEGREES = 180_000.0 / math.pi  # per rad; positions of joints on the bus
MICROMETRES, MILLI = 1e6, 1e-3  # per m, of the opening; of speeds [rad/s] and torques [Nm]
ALL, CAN_CONTROL, MOVE_J, FULL_SPEED, GRIPPER_ON, STOP, STOPPED = 7, 1, 1, 100, 1, 1, 1
ENABLE_MAX_S, REPEAT_S, POLL_S = 1.0, 0.05, 0.001
FAULTS = (
    "voltage_too_low",
    "motor_overheating",
    "driver_overcurrent",
    "driver_overheating",
    "collision_status",
    "driver_error_status",
    "stall_status",
)


class PiperSettings(DeviceSettings):
    """The bus and the gripper.

    Attributes:
        interface: Kind of the CAN interface, as `python-can` names it.
        gripper_torque_nm: Greatest torque of the gripper's drive [Nm].
    """

    interface: str = "socketcan"
    gripper_torque_nm: float = pydantic.Field(default=1.0, gt=0.0, le=5.0)


class PiperBus(Bus):
    """The arm on the CAN channel of the profile's `endpoint`; `sdk` is the package `piper_sdk`."""

    def __init__(self, sdk: ModuleType, profile: TargetProfile, settings: PiperSettings, clock: Clock) -> None:
        self._place, self._settings, self._clock = profile.endpoint, settings, clock
        self._arm = sdk.C_PiperInterface_V2(profile.endpoint, judge_flag=False, can_auto_init=False)
        try:
            self._arm.CreateCanBus(profile.endpoint, bustype=settings.interface, judge_flag=False)
        except ConnectionError as error:
            cause = error.__context__ or error
            raise ExecutionError("TARGET_LOST", f"{self._place}: {cause}; check cable and interface") from error
        self._arm.ConnectPort(piper_init=False)

    @override
    def read(self) -> Reading:
        status = self._await_feedback()
        joints, gripper = self._arm.GetArmJointMsgs().joint_state, self._arm.GetArmGripperMsgs().gripper_state
        motors, drives = self._arm.GetArmHighSpdInfoMsgs(), self._arm.GetArmLowSpdInfoMsgs()
        faults = [
            f"joint {each}: {name}"
            for each in range(1, 7)
            for name in FAULTS
            if getattr(getattr(drives, f"motor_{each}").foc_status, name)
        ]
        if status.arm_status:
            faults.append(status.arm_status.name)
        return Reading(
            q_rad=np.array([getattr(joints, f"joint_{each}") for each in range(1, 7)]) / MILLIDEGREES,
            qd_rad_s=np.array([getattr(motors, f"motor_{each}").motor_speed for each in range(1, 7)]) * MILLI,
            width_m=max(gripper.grippers_angle / MICROMETRES, 0.0),
            fault=", ".join(faults).replace("_", " ").lower(),
        )

    @override
    def enable(self, q_rad: Array, width_m: float) -> None:
        """Power the drives, which hold this posture; raises ExecutionError `PROTECTIVE_STOP` if a person must act."""
        if self._await_feedback().arm_status == STOPPED:
            hint = "support the arm, which falls, and reset it (C_PiperInterface_V2.ResetPiper)"
            raise ExecutionError("PROTECTIVE_STOP", f"{self._place}: the arm is in its emergency stop; {hint}")
        end_s = self._clock.now_s() + ENABLE_MAX_S
        while True:
            self._arm.EnableArm(ALL)
            self._arm.ModeCtrl(CAN_CONTROL, MOVE_J, FULL_SPEED)
            self.write(q_rad, np.zeros_like(q_rad), width_m)
            self._clock.sleep(REPEAT_S)
            if self._await_feedback().ctrl_mode == CAN_CONTROL and all(self._arm.GetArmEnableStatus()):
                return
            if self._clock.now_s() > end_s:
                raise ExecutionError("PROTECTIVE_STOP", f"{self._place}: the drives do not switch on; look at the arm")

    @override
    def write(self, q_rad: Array, qd_rad_s: Array, width_m: float) -> None:
        self._arm.JointCtrl(*np.rint(q_rad * MILLIDEGREES).astype(int).tolist())
        torque = round(self._settings.gripper_torque_nm / MILLI)
        self._arm.GripperCtrl(round(width_m * MICROMETRES), torque, GRIPPER_ON)

    @override
    def stop(self) -> None:
        """0x150 with 1, until the arm says that it stopped; its joints then sink slowly."""
        end_s = self._clock.now_s() + self._settings.silence_max_s
        self._arm.EmergencyStop(STOP)
        while self._await_feedback().arm_status != STOPPED:
            if self._clock.now_s() > end_s:
                raise ExecutionError("TARGET_LOST", f"{self._place}: the arm does not confirm its emergency stop")
            self._arm.EmergencyStop(STOP)

    @override
    def close(self) -> None:
        self._arm.DisconnectPort()
        type(self._arm)._instances.pop(self._place, None)  # its reader does not survive: the next one needs another

    def _await_feedback(self) -> Any:
        """The status of the arm, after frames of every kind that came since the call."""
        before, end_s = self._read_stamps(), self._clock.now_s() + self._settings.silence_max_s
        while any(now == then for now, then in zip(self._read_stamps(), before, strict=True)):
            if self._clock.now_s() > end_s:
                silence = f"no feedback within {self._settings.silence_max_s} s"
                raise ExecutionError("TARGET_LOST", f"{self._place}: {silence}; check cable, power and interface")
            self._clock.sleep(POLL_S)
        return self._arm.GetArmStatus().arm_status

    def _read_stamps(self) -> list[float]:
        """Times of the latest frames."""
        arm = self._arm
        kinds = (arm.GetArmStatus, arm.GetArmJointMsgs, arm.GetArmGripperMsgs, arm.GetArmHighSpdInfoMsgs)
        return [read().time_stamp for read in kinds]
