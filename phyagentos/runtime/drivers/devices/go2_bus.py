"""The legs of a Unitree Go2 at low level: topics `rt/lowcmd` and `rt/lowstate` of DDS, by Cyclone DDS.

Each motor follows tau = kp (q - q_now) + kd (dq - dq_now), with the gains of the profile. The latest command is
repeated every 10 ms, as the vendor's examples repeat theirs. The emergency stop is damping, kp = 0 in all motors: the
legs sink. The robot's sport mode publishes `rt/lowcmd`, too: while it does, no session begins, and one that runs ends.
"""

import contextlib
import dataclasses
import threading
import types
import zlib
from functools import cache, partial
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
import pydantic
from typing_extensions import override

from phyagentos.clock import Clock
from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.runtime.drivers.devices.device_driver import Array, Bus, DeviceSettings, Reading

STRUCTS = {
    "MotorCmd_": "uint8 mode, float32 q, float32 dq, float32 tau, float32 kp, float32 kd, uint32[3] reserve",
    "BmsCmd_": "uint8 off, uint8[3] reserve",
    "LowCmd_": "uint8[2] head, uint8 level_flag, uint8 frame_reserve, uint32[2] sn, uint32[2] version, "
    "uint16 bandwidth, MotorCmd_[20] motor_cmd, BmsCmd_ bms_cmd, uint8[40] wireless_remote, uint8[12] led, "
    "uint8[2] fan, uint8 gpio, uint32 reserve, uint32 crc",
    "IMUState_": "float32[4] quaternion, float32[3] gyroscope, float32[3] accelerometer, float32[3] rpy, "
    "uint8 temperature",
    "MotorState_": "uint8 mode, float32 q, float32 dq, float32 ddq, float32 tau_est, float32 q_raw, float32 dq_raw, "
    "float32 ddq_raw, uint8 temperature, uint32 lost, uint32[2] reserve",
    "BmsState_": "uint8 version_high, uint8 version_low, uint8 status, uint8 soc, int32 current, uint16 cycle, "
    "uint8[2] bq_ntc, uint8[2] mcu_ntc, uint16[15] cell_vol",
    "LowState_": "uint8[2] head, uint8 level_flag, uint8 frame_reserve, uint32[2] sn, uint32[2] version, "
    "uint16 bandwidth, IMUState_ imu_state, MotorState_[20] motor_state, BmsState_ bms_state, int16[4] foot_force, "
    "int16[4] foot_force_est, uint32 tick, uint8[40] wireless_remote, uint8 bit_flag, float32 adc_reel, "
    "uint8 temperature_ntc1, uint8 temperature_ntc2, float32 power_v, float32 power_a, uint16[4] fan_frequency, "
    "uint32 reserve, uint32 crc",
}
MOTORS_AT = 24  # where a C struct has the motors; CDR, which aligns no struct, has them two bytes before
HEAD, LOW_LEVEL, SERVO = (0xFE, 0xEF), 0xFF, 1
REPEAT_S, POLL_S, LISTEN_S, DISCOVERY_S = 0.01, 0.001, 0.1, 2.0
OTHERS = "another program commands the legs on rt/lowcmd"
UNICAST = """<AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer Address={peer}/></Peers></Discovery>"""
CONFIGURATION = """<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name={interface}/></Interfaces>
{rest}</Domain></CycloneDDS>"""


class Messages(NamedTuple):
    """Classes of the messages; fields are zero unless they are given."""

    motor: Any
    command: Any
    state: Any


@cache
def define_messages() -> Messages:
    """A class has one topic type in a process, so this is the same each time; it needs the package `cyclonedds`."""
    known: Fields = {}
    for name, text in STRUCTS.items():
        known[name] = _define(name, text, known)
    return Messages(known["MotorCmd_"], known["LowCmd_"], known["LowState_"])


def _define(name: str, text: str, known: Fields) -> Any:
    """A dataclass for a struct of the IDL."""
    from cyclonedds import idl
    from cyclonedds.idl import annotations
    from cyclonedds.idl import types as kinds

    hints, space = {}, {}
    for kind, field in (each.split() for each in text.split(", ")):
        kind, _, count = kind.rstrip("]").partition("[")
        element = known.get(kind) or getattr(kinds, kind)
        make = known.get(kind) or (float if kind == "float32" else int)
        hints[field] = kinds.array[element, int(count)] if count else element
        space[field] = dataclasses.field(default_factory=partial(_make, make, int(count)) if count else make)
    names = {"typename": f"unitree_go.msg.dds_.{name}"}
    struct = types.new_class(name, (idl.IdlStruct,), names, lambda body: body.update(space, __annotations__=hints))
    return dataclasses.dataclass(annotations.final(annotations.autoid("sequential")(struct)))


def _make(make: Any, count: int) -> list[Any]:
    return [make() for _ in range(count)]


def compute_crc(command: Any) -> int:
    """CRC-32/MPEG-2 of a `LowCmd_` as the C struct has it, word by word, without its last word."""
    cdr = command.serialize()[4:]  # behind the encapsulation header
    gap = bytes(2)
    struct = cdr[: MOTORS_AT - 2] + gap + cdr[MOTORS_AT - 2 : MOTORS_AT] + gap + cdr[MOTORS_AT:-4]
    bits = np.unpackbits(np.frombuffer(struct, "<u4").astype(">u4").view(np.uint8))
    mirrored = zlib.crc32(np.packbits(bits, bitorder="little").tobytes()) ^ 0xFFFFFFFF  # zlib begins at the lowest bit
    return int(f"{mirrored:032b}"[::-1], 2)


class Go2Settings(DeviceSettings):
    """The network.

    Attributes:
        domain: Number of the DDS domain; robots are in 0.
        peer: Address that is asked for participants, instead of by multicast; empty for multicast.
    """

    domain: int = pydantic.Field(default=0, ge=0, le=232)
    peer: str = ""


class Go2Bus(Bus):
    """Twelve motors, in the order of the profile's joints, on the network interface of its `endpoint`."""

    def __init__(self, profile: TargetProfile, settings: Go2Settings, clock: Clock) -> None:
        from cyclonedds.core import DDSException, Policy, Qos
        from cyclonedds.domain import Domain, DomainParticipant
        from cyclonedds.pub import DataWriter
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic

        self._place, self._settings, self._clock, arm = profile.endpoint, settings, clock, profile.arm
        self._gains = list(zip(arm.stiffness_nm_rad, arm.damping_nms_rad, strict=True))
        rest = UNICAST.format(peer=quoteattr(settings.peer)) if settings.peer else "</General>"
        configuration = CONFIGURATION.format(interface=quoteattr(self._place), rest=rest)
        try:
            self._domain = Domain(settings.domain, configuration)
        except DDSException as error:
            cause = f"{self._place}, domain {settings.domain}: {error}; check cable and interface"
            raise ExecutionError("TARGET_LOST", cause) from error
        participant = DomainParticipant(settings.domain)
        self._messages = define_messages()
        commands = Topic(participant, "rt/lowcmd", self._messages.command)
        self._states = DataReader(participant, Topic(participant, "rt/lowstate", self._messages.state))
        self._others = DataReader(participant, commands, Qos(Policy.IgnoreLocal.Participant))
        self._writer = DataWriter(participant, commands)
        self._command: Any = None  # the latest
        self._ended, self._lock = threading.Event(), threading.Lock()
        self._thread = threading.Thread(target=self._repeat, daemon=True, name="rt/lowcmd")
        self._thread.start()
        with contextlib.suppress(ExecutionError):  # a robot that stays silent is lost when it is asked
            self._await_state(DISCOVERY_S)

    @override
    def read(self) -> Reading:
        motors = self._await_state(self._settings.silence_max_s).motor_state[: len(self._gains)]
        return Reading(
            q_rad=np.array([motor.q for motor in motors]),
            qd_rad_s=np.array([motor.dq for motor in motors]),
            fault=OTHERS if _take(self._others) else "",
        )

    @override
    def enable(self, q_rad: Array, width_m: float) -> None:
        """Hold this posture; raises ExecutionError `BUSY` while another program commands the legs."""
        _take(self._others)
        self._clock.sleep(LISTEN_S)
        if _take(self._others):
            hint = "release the sport mode first (MotionSwitcherClient.ReleaseMode)"
            raise ExecutionError("BUSY", f"{self._place}: {OTHERS}; {hint}")
        self.write(q_rad, np.zeros_like(q_rad), width_m)

    @override
    def write(self, q_rad: Array, qd_rad_s: Array, width_m: float) -> None:
        rows = zip(q_rad.tolist(), qd_rad_s.tolist(), self._gains, strict=True)
        self._send([self._messages.motor(mode=SERVO, q=q, dq=dq, kp=kp, kd=kd) for q, dq, (kp, kd) in rows])

    @override
    def stop(self) -> None:
        self._send([self._messages.motor(mode=SERVO, kd=kd) for _, kd in self._gains])
        self._await_state(self._settings.silence_max_s)

    @override
    def close(self) -> None:
        """Nothing is repeated any more; what the motors do then is the robot's own."""
        self._ended.set()
        self._thread.join()
        self._states = self._others = self._writer = self._domain = None

    def _send(self, motors: list[Any]) -> None:
        command = self._messages.command(head=[*HEAD], level_flag=LOW_LEVEL)
        command.motor_cmd[: len(motors)] = motors
        command.crc = compute_crc(command)
        with self._lock:
            self._command = command
            self._writer.write(command)

    def _repeat(self) -> None:
        while not self._ended.wait(REPEAT_S):
            with self._lock:
                if self._command is not None:
                    self._writer.write(self._command)

    def _await_state(self, longest_s: float) -> Any:
        """A state that came since the call."""
        _take(self._states)
        end_s = self._clock.now_s() + longest_s
        while not (found := _take(self._states)):
            if self._clock.now_s() > end_s:
                silence = f"no LowState within {longest_s} s"
                raise ExecutionError("TARGET_LOST", f"{self._place}: {silence}; check cable, power and interface")
            self._clock.sleep(POLL_S)
        return found[0]


def _take(reader: Any) -> list[Any]:
    """The latest sample, if one came since the last time; notices without data are left out."""
    return [sample for sample in reader.take() if sample.sample_info.valid_data]
