"""Messages of a Unitree Go2's low level, fields and order as in the IDL files of `unitree_sdk2` (unitree_go/msg/dds_).

The vendor's own Python package is not used: it pins an older Cyclone DDS.
"""

import dataclasses
import types
import zlib
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

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


class Messages(NamedTuple):
    """Classes of the messages; fields are zero unless they are given."""

    motor: Any
    command: Any
    state: Any


@cache
def define_messages() -> Messages:
    """A class has one topic type in a process, so this is the same each time; it needs the package `cyclonedds`."""
    known: dict[str, Any] = {}
    for name, text in STRUCTS.items():
        known[name] = _define(name, text, known)
    return Messages(known["MotorCmd_"], known["LowCmd_"], known["LowState_"])


def _define(name: str, text: str, known: dict[str, Any]) -> Any:
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
