"""The wire of phyagentos, as a target speaks it: msgpack maps with a `type`, arrays as little-endian doubles.

What comes in is checked against `FIELDS` before anything acts on it; the numbers of an array are unpacked by who knows
its shape (`unpack`). No message is ever evaluated or unpickled.
"""

import hmac
import math
import struct
from collections.abc import Callable
from functools import partial
from typing import Any

try:
    import msgpack
except ImportError:  # an environment that has phyagentos has this one, with the same bytes
    from msgspec import msgpack

VERSION = 5
KEY_BYTES = 32
MESSAGE_MAX_BYTES = 2**26
GREETING_MAX_BYTES = 2**12  # of who has shown no token
ITEMS_MAX = 2**12  # of one list or map: a message is long by its bytes, never by its items
TEXT_MAX = 2**16
ARRAYS = ("q_rad", "qd_rad_s", "gripper_width_m")

_SESSION = {"session": str, "epoch": int}
FIELDS: dict[str, dict[str, type]] = {
    "Describe": {},
    "LoadScene": {"scene": str, "seed": int, "episode": str, "snapshot": bytes, "may_reset": bool},
    "Begin": {**_SESSION, "token": bytes},
    "Command": {**_SESSION, "sequence": int, "expires_at_s": float, **dict.fromkeys(ARRAYS, dict)},
    "Announce": {**_SESSION, "q_rad": dict, "beside": str},
    "Call": {**_SESSION, "number": int, "procedure": str, "goal": dict, "cancel_within_s": float},
    "Follow": {**_SESSION, "number": int},
    "Cancel": {**_SESSION, "number": int},
    "Halt": {**_SESSION, "category": int, "is_emergency": bool},
    "Settle": {**_SESSION, "duration_s": float},
    "End": _SESSION,
    "Observe": {"truth": bool, "snapshot": bool},
    "Capture": {"cameras": list, "crops": dict, "every": int},
    "InvokeTool": {"name": str, "arguments": dict, **_SESSION},
    "Shutdown": {},
}
_DEFAULTS: dict[str, Any] = {
    "may_reset": True, "token": b"", "category": 2, "is_emergency": False, "truth": False, "cameras": [], "crops": {},
    "every": 1, "arguments": {}, "session": "", "epoch": 0, "beside": "",
}  # fmt: skip
_SNAPSHOT = {"Observe": False, "LoadScene": b""}
_PLANS = {
    kind: [(name, of, _SNAPSHOT[kind] if name == "snapshot" else _DEFAULTS.get(name)) for name, of in fields.items()]
    for kind, fields in FIELDS.items()
}
"""Name, type and default of each field."""


class Refusal(Exception):
    """A request is refused by a code; nothing has moved."""

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


def mint(key: bytes, session: str = "", epoch: int = 0) -> bytes:
    """The token of one epoch of a session; without a session, the one to connect with."""
    return hmac.new(key, f"{epoch} {session}".encode(), "sha256").digest()


def encode(kind: str, **fields: Any) -> bytes:
    """One message."""
    return _pack({"type": kind, **fields})


def decode_greeting(message: bytes) -> tuple[int, bytes]:
    """Version and token of a client's first message; raises `Refusal`."""
    greeting = _unpack(message) if len(message) <= GREETING_MAX_BYTES else {}
    version, token = greeting.get("version"), greeting.get("token")
    if greeting.get("type") != "Hello" or type(version) is not int or not isinstance(token, bytes):
        raise Refusal("MALFORMED", "the first message is no greeting")
    return version, token


def is_describe(message: bytes) -> bool:
    """Whether a message is a `Describe`; what is longer than one is not decoded."""
    try:
        return len(message) <= _DESCRIBE_BYTES and _unpack(message).get("type") == "Describe"
    except Refusal:
        return False


def decode(message: bytes) -> dict[str, Any]:
    """One request with every field of its type; raises `Refusal` `MALFORMED`."""
    request = _unpack(message)
    kind = request.get("type")
    if not isinstance(kind, str) or kind not in FIELDS:
        raise Refusal("MALFORMED", f"{kind!r} is no request")
    found: dict[str, Any] = {"type": kind}
    for name, expected, default in _PLANS[kind]:
        value = request.get(name, default)
        if expected is float and type(value) is int:
            value = float(value)
        if type(value) is not expected:
            raise Refusal("MALFORMED", f"{kind}.{name}: {type(value).__name__}; expected {expected.__name__}")
        found[name] = value
    return found


# A packer is kept, for a new one begins with a megabyte of its own.
_pack: Callable[[Any], bytes] = msgpack.Packer().pack if hasattr(msgpack, "Packer") else msgpack.encode
_read: Callable[[bytes], Any] = (
    partial(msgpack.unpackb, max_array_len=ITEMS_MAX, max_map_len=ITEMS_MAX, max_str_len=TEXT_MAX)
    if hasattr(msgpack, "unpackb")
    else msgpack.decode
)
_DESCRIBE_BYTES = len(encode("Describe"))


def _unpack(message: bytes) -> dict[str, Any]:
    try:
        found = _read(message)
    except Exception as error:  # both libraries have several, some without a common base
        raise Refusal("MALFORMED", f"{len(message)} bytes that are no message: {error}") from error
    if not isinstance(found, dict):
        raise Refusal("MALFORMED", f"a {type(found).__name__} is no message")
    return found


def unpack(name: str, value: dict[str, Any], shape: tuple[int, ...]) -> Any:
    """Rows of a matrix, or the numbers of a vector, of this shape: another one is refused before it is unpacked."""
    n, data = math.prod(shape), value.get("f8")
    if value.get("shape") != list(shape) or not isinstance(data, bytes) or len(data) != 8 * n:
        raise Refusal("MALFORMED", f"{name}: not {' rows of '.join(map(str, shape))} doubles")
    numbers = list(struct.unpack(f"<{n}d", data))
    if not all(map(math.isfinite, numbers)):
        raise Refusal("MALFORMED", f"{name}: a set-point is not finite")
    if len(shape) == 1:
        return numbers
    rows, columns = shape
    return [numbers[row * columns : (row + 1) * columns] for row in range(rows)]
