"""The serial bus of an SO-101: Feetech STS3215 servos, packet protocol 0 of `feetech-servo-sdk`.

A servo has no emergency stop of its own; its stop is a goal where it stands.
"""

import math
import termios
from collections.abc import Callable, Sequence
from functools import partial
from types import ModuleType
from typing import Literal, TypeVar

import numpy as np
import pydantic
from numpy.typing import NDArray
from typing_extensions import override

from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.drivers.devices.device_driver import Array, Bus, DeviceSettings, Reading

ReturnT = TypeVar("ReturnT")

OFFSET, TORQUE, ACCELERATION, PRESENT, STATUS = 31, 40, 41, 56, 65  # registers
PRESENT_BYTES = STATUS - PRESENT + 1  # position, speed, load, voltage, temperature, a flag, status
ANSWER_S = 0.04  # the longest that the package waits for an answer of six servos
STEP_RAD = 2.0 * math.pi / 4096.0
SPEED_SHARE, SPEED_MIN = 1.2, 60  # a goal is reached before the next one comes [1, steps/s]; 0 would be the fastest
FAULTS = {1: "voltage", 2: "position sensor", 4: "temperature", 8: "current", 32: "overload"}


class So101Settings(DeviceSettings):
    """Servos and calibration; positions of servos are in steps, 4096 a turn.

    Attributes:
        ids: Of the servos, one per joint.
        zero_steps: Where each servo stands at joint position zero.
        directions: 1 where servo and joint turn the same way, -1 otherwise.
        jaw_id: Of the servo that opens the gripper.
        jaw_closed_steps: Where it stands when the gripper is closed.
        jaw_open_steps: Where it stands at the widest opening.
        baud_rate: Of the bus.
        calibrated_at: When `paos robot calibrate` measured these numbers; empty where they were written by hand.
        offsets: What each servo then kept as its own offset, the jaw's last, as its register has it: with another one
            it counts from elsewhere.
    """

    ids: tuple[int, ...]
    zero_steps: tuple[int, ...]
    directions: tuple[Literal[1, -1], ...]
    jaw_id: int
    jaw_closed_steps: int
    jaw_open_steps: int
    baud_rate: int = pydantic.Field(default=1_000_000, gt=0)
    calibrated_at: str = ""
    offsets: list[int] = []


class So101Bus(Bus):
    """The servos behind the serial port of the profile's `endpoint`; `sdk` is the package `scservo_sdk`."""

    def __init__(self, sdk: ModuleType, profile: TargetProfile, settings: So101Settings) -> None:
        self._sdk, self._step_s, self._place = sdk, profile.physics_step_s, profile.endpoint
        self._settings, self._width_max_m = settings, profile.gripper.max_width_m
        self._ids = (*settings.ids, settings.jaw_id)
        self._zero, self._way = np.array(settings.zero_steps), np.array(settings.directions)
        self._goals: list[int] = []
        self._port = sdk.PortHandler(profile.endpoint)
        self._port.baudrate = settings.baud_rate
        self._packets = sdk.PacketHandler(0)
        self._present = sdk.GroupSyncRead(self._port, self._packets, PRESENT, PRESENT_BYTES)
        for each in self._ids:
            self._present.addParam(each)
        self._call(self._port.openPort)

    def check_calibration(self) -> None:
        """Raises DefinitionError `CHANGED` where a servo counts from elsewhere than when it was calibrated."""
        known = self._settings.offsets
        if known and (found := self.read_offsets()) != known:
            raise DefinitionError.of(
                "CHANGED",
                f"{self._place}: offsets of the servos",
                f"{found}",
                f"{known}, as calibrated at {self._settings.calibrated_at}",
                hint="Another program has set them, or a servo was replaced: paos robot calibrate.",
            )

    def read_offsets(self) -> list[int]:
        """The register of each servo, the jaw's last."""
        found: list[int] = []

        def read(servo: int) -> int:
            word, result, _ = self._packets.read2ByteTxRx(self._port, servo, OFFSET)
            found[:] = [*found, word] if result == self._sdk.COMM_SUCCESS else found
            return int(result)

        for each in self._ids:
            self._ask(partial(read, each), f"servo {each}")
        return found

    def release(self) -> None:
        """Torque off: the arm sinks, and is moved by hand."""
        rows = [word for each in self._ids for word in (each, 0)]
        self._ask(lambda: self._packets.syncWriteTxOnly(self._port, TORQUE, 1, rows, len(rows)), "the bus")

    def read_steps(self) -> list[int]:
        """Where each servo stands, the jaw's last."""
        return [int(each) for each in self._read_steps()[0]]

    @override
    def read(self) -> Reading:
        steps, speeds = self._read_steps()
        faults = [
            f"servo {each}: {name}"
            for each in self._ids
            for bit, name in FAULTS.items()
            if self._present.getData(each, STATUS, 1) & bit
        ]
        opened = (steps[-1] - self._settings.jaw_closed_steps) / self._jaw_range
        return Reading(
            q_rad=STEP_RAD * self._way * (steps[:-1] - self._zero),
            qd_rad_s=STEP_RAD * self._way * speeds[:-1],
            width_m=float(np.clip(opened, 0.0, 1.0)) * self._width_max_m,
            fault=", ".join(faults),
        )

    @override
    def enable(self, q_rad: Array, width_m: float) -> None:
        self.stop()

    @override
    def write(self, q_rad: Array, qd_rad_s: Array, width_m: float) -> None:
        jaw = self._settings.jaw_closed_steps + self._jaw_range * width_m / max(self._width_max_m, 1e-9)
        goals = [*np.rint(self._zero + self._way * q_rad / STEP_RAD).astype(int).tolist(), round(jaw)]
        ways = zip(self._goals, goals, strict=True)
        self._send(goals, [SPEED_MIN + int(SPEED_SHARE * abs(end - start) / self._step_s) for start, end in ways])

    @override
    def stop(self) -> None:
        """Torque on, and the goal where each servo stands, in one frame."""
        steps, _ = self._read_steps()
        self._send(steps.tolist(), [SPEED_MIN] * len(steps), torque=(1,))

    @override
    def close(self) -> None:
        self._port.closePort()

    @property
    def _jaw_range(self) -> int:
        return self._settings.jaw_open_steps - self._settings.jaw_closed_steps

    def _read_steps(self) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
        """Positions and speeds of all servos, (n_servos,) [steps, steps/s]."""
        self._ask(self._present.txRxPacket, "a servo")
        words = [[self._present.getData(each, PRESENT + at, 2) for each in self._ids] for at in (0, 2)]
        steps, speeds = [[self._sdk.SCS_TOHOST(word, 15) for word in each] for each in words]
        return np.array(steps), np.array(speeds)

    def _ask(self, question: Callable[[], int], whom: str) -> None:
        """A question until it is answered; what is left of an earlier one is dropped."""
        for _ in range(max(round(self._settings.silence_max_s / ANSWER_S), 1)):
            self._port.is_using = False  # the package keeps it where a packet was cut off
            self._call(self._port.ser.reset_input_buffer)
            if (result := self._call(question)) == self._sdk.COMM_SUCCESS:
                return
        raise ExecutionError("TARGET_LOST", f"{self._place}: {whom}: {self._packets.getTxRxResult(result)}")

    def _send(self, goals: list[int], speeds: Sequence[int], torque: tuple[int, ...] = ()) -> None:
        """One frame for all servos: torque where it is given, acceleration, position, time, speed."""
        low, high = self._sdk.SCS_LOBYTE, self._sdk.SCS_HIBYTE
        rows: list[int] = []
        for each, goal, speed in zip(self._ids, goals, speeds, strict=True):
            word = self._sdk.SCS_TOSCS(goal, 15)
            rows += [each, *torque, 0, low(word), high(word), 0, 0, low(speed), high(speed)]
        at, length = ACCELERATION - len(torque), 7 + len(torque)
        self._ask(lambda: self._packets.syncWriteTxOnly(self._port, at, length, rows, len(rows)), "the bus")
        self._goals = goals

    def _call(self, act: "Callable[[], ReturnT]") -> "ReturnT":
        try:
            return act()
        except (OSError, TypeError, termios.error) as error:  # TypeError: pyserial, of a port that was closed
            raise ExecutionError("TARGET_LOST", f"{self._place}: {error}; check cable and power") from error


def open_so101(sdk: ModuleType, profile: TargetProfile, settings: So101Settings) -> So101Bus:
    """The bus of servos that count as when they were calibrated; raises DefinitionError `CHANGED`."""
    bus = So101Bus(sdk, profile, settings)
    try:
        bus.check_calibration()
    except (DefinitionError, ExecutionError):
        bus.close()
        raise
    return bus
