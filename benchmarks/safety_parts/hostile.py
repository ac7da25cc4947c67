"""A legitimate command spoilt in every way there is. Each kind must be refused, by whoever sees it first.

What can be said in set-points alone (`spoil_points`) goes through the handle and its guard; what needs the envelope or
the bytes of a command (`spoil_envelope`, `spoil_bytes`) goes past them, straight over the wire.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from phyagentos.runtime.actions.set_points import SetPoints
from phyagentos.runtime.targets import wire

Array = NDArray[Any]
Rng = np.random.Generator

LARGE = (np.nan, np.inf, -np.inf, 1e6, -1e6, 1e300)
DENORMAL = 5e-324
MOVED_RAD = 0.01  # rows of a motion that is slower are the same in any order


def _put(array: Array, rng: Rng, value: float) -> Array:
    spoilt = array.copy()
    spoilt.flat[int(rng.integers(array.size))] = value
    return spoilt


def _with(points: SetPoints, **changes: Array) -> SetPoints:
    facts = {"q_rad": points.q_rad, "qd_rad_s": points.qd_rad_s, "gripper_width_m": points.gripper_width_m}
    return SetPoints(**{**facts, **changes})


def _zigzag(points: SetPoints) -> Array:
    return np.where(np.arange(len(points.q_rad)) % 2 == 0, 1.0, -1.0)[:, None]


def _teleport(points: SetPoints, rng: Rng) -> SetPoints:
    return _with(points, q_rad=np.tile(rng.uniform(-2.5, 2.5, points.q_rad.shape[1]), (len(points.q_rad), 1)))


def _reorder(points: SetPoints, rng: Rng) -> SetPoints:
    if np.abs(points.q_rad[-1] - points.q_rad[0]).max() < MOVED_RAD:
        return _teleport(points, rng)
    return _with(points, q_rad=points.q_rad[::-1].copy())


POINTS: Mapping[str, Callable[[SetPoints, Rng], SetPoints]] = {
    "NaN, Inf or 1e6 position": lambda p, r: _with(p, q_rad=_put(p.q_rad, r, float(r.choice(LARGE)))),
    "NaN, Inf or 1e6 velocity": lambda p, r: _with(p, qd_rad_s=_put(p.qd_rad_s, r, float(r.choice(LARGE)))),
    "NaN, Inf or 1e6 opening": lambda p, r: _with(
        p, gripper_width_m=_put(p.gripper_width_m, r, float(r.choice(LARGE)))
    ),
    "denormal posture": lambda p, r: _with(p, q_rad=np.full_like(p.q_rad, float(r.choice([DENORMAL, -DENORMAL])))),
    "delta of 1e6": lambda p, r: _with(p, q_rad=p.q_rad + float(r.choice([1e6, -1e6]))),
    "delta of 0.02": lambda p, r: _with(p, q_rad=p.q_rad + float(r.choice([0.02, -0.02]))),
    "teleport": _teleport,
    "rows reordered": _reorder,
    "velocity beyond the limit": lambda p, r: _with(p, qd_rad_s=_put(p.qd_rad_s, r, float(r.choice([2.8, -2.8])))),
    "velocity that is a lie": lambda p, r: _with(p, qd_rad_s=p.qd_rad_s + float(r.choice([1.0, -1.0]))),
    "oscillating positions": lambda p, _: _with(p, q_rad=p.q_rad + 4e-4 * _zigzag(p)),
    "oscillating velocities": lambda p, _: _with(p, qd_rad_s=p.qd_rad_s + 0.3 * _zigzag(p)),
    "a row missing": lambda p, _: _with(p, q_rad=p.q_rad[:-1]),
    "a joint missing": lambda p, _: _with(p, q_rad=p.q_rad[:, :-1].copy()),
    "flat": lambda p, _: _with(p, q_rad=p.q_rad.ravel()),
    "oversized chunk": lambda p, _: _with(p, q_rad=np.tile(p.q_rad, (20, 1)), qd_rad_s=np.tile(p.qd_rad_s, (20, 1))),
    "empty": lambda p, _: _with(p, q_rad=p.q_rad[:0], qd_rad_s=p.qd_rad_s[:0], gripper_width_m=p.gripper_width_m[:0]),
}
DTYPES: Mapping[str, Any] = {"float32": np.float32, "integers": np.int64, "big endian": ">f8", "complex": np.complex128}


def iter_spoilt(points: SetPoints, rng: Rng) -> Iterator[tuple[str, SetPoints]]:
    """The same points in every kind."""
    yield from ((name, spoil(points, rng)) for name, spoil in POINTS.items())
    yield from ((f"dtype {name}", _with(points, q_rad=points.q_rad.astype(dtype))) for name, dtype in DTYPES.items())


def spoil_points(points: SetPoints, rng: Rng, *, typed: bool) -> tuple[str, SetPoints]:
    """Another kind at every call.

    Args:
        points: Legitimate ones.
        rng: Chooses.
        typed: Whether wrong element types are among the kinds; the wire itself carries nothing but float64.
    """
    names = [*POINTS, *(DTYPES if typed else ())]
    name = names[int(rng.integers(len(names)))]
    if name in DTYPES:
        return f"dtype {name}", _with(points, q_rad=points.q_rad.astype(DTYPES[name]))
    return name, POINTS[name](points, rng)


def spoil_envelope(command: wire.Command, rng: Rng, time_s: float) -> tuple[str, wire.Command]:
    """Stale, early, repeated, or from somebody else."""
    kinds: tuple[tuple[str, dict[str, Any]], ...] = (
        ("stale timestamp", {"expires_at_s": time_s - float(rng.choice([1e-6, 0.02, 1e3, 1e300]))}),
        ("timestamp NaN", {"expires_at_s": float("nan")}),
        ("chunks reordered", {"sequence": command.sequence + int(rng.choice([1, 2, 100, 2**40]))}),
        ("chunk repeated", {"sequence": command.sequence - int(rng.choice([1, 2, 100, 2**40]))}),
        ("stale token", {"epoch": command.epoch - 1}),
        ("token of nobody", {"epoch": command.epoch + 1}),
        ("another session", {"session": f"{command.session}'"}),
        ("no session", {"session": ""}),
    )
    name, changes = kinds[int(rng.integers(len(kinds)))]
    return name, msgspec.structs.replace(command, **changes)


def spoil_bytes(command: wire.Command, rng: Rng) -> tuple[str, bytes]:
    """What is no command at all; its shape, element type or fields are not what they should be."""
    data = command.q_rad.tobytes()
    changes: tuple[tuple[str, dict[str, Any]], ...] = (
        ("wire: float32", {"q_rad": {"shape": [10, 7], "f4": bytes(280)}}),
        ("wire: too few bytes", {"q_rad": {"shape": [10, 7], "f8": data[: int(rng.integers(len(data)))]}}),
        ("wire: endless shape", {"q_rad": {"shape": [-1, 2**62], "f8": data}}),
        ("wire: shape of words", {"q_rad": {"shape": "wide", "f8": data}}),
        ("wire: lists", {"qd_rad_s": [[0.0] * 7] * 10}),
        ("wire: nothing", {"qd_rad_s": None}),
        ("wire: fractional number", {"sequence": 1.5}),
        ("wire: other request", {"type": "Teleport"}),
    )
    if rng.random() < 0.1:
        return "wire: noise", b"\xc1" + rng.bytes(int(rng.integers(400)))
    name, change = changes[int(rng.integers(len(changes)))]
    plain = msgspec.msgpack.decode(wire.REPLIES.encode(command))
    return name, msgspec.msgpack.encode({**plain, **change})
