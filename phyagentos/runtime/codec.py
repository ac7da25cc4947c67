"""Typed messages in msgpack, arrays included: C order with their shape.

Numbers travel as float64; pictures (uint8) and depth (float32) keep their type, since they are large.
"""

import re
from typing import Any, Generic, TypeVar

import msgspec
import numpy as np

from phyagentos.errors import ExecutionError
from phyagentos.protocol.documents.struct_schema import reword

_KINDS = {"f8": "<f8", "f4": "<f4", "u1": "|u1"}
_BROKEN = (msgspec.MsgspecError, ValueError, TypeError, NotImplementedError, RecursionError)

MessageT = TypeVar("MessageT")


class Codec(Generic[MessageT]):
    """The messages of one direction: `kind` is their type, a union of tagged structs, `what` their name in errors."""

    def __init__(self, kind: Any, what: str) -> None:
        self._what = what
        self._decoder: msgspec.msgpack.Decoder[MessageT] = msgspec.msgpack.Decoder(kind, dec_hook=_decode_array)
        self.encode = msgspec.msgpack.Encoder(enc_hook=_encode_array).encode

    def decode(self, message: bytes) -> MessageT:
        """One message; raises ExecutionError `MALFORMED` when the bytes are none."""
        try:
            return self._decoder.decode(message)
        except _BROKEN as error:
            found = f"{len(message)} bytes that are no {self._what}: {_explain(error)}"
            raise ExecutionError("MALFORMED", found) from error


def _explain(error: Exception) -> str:
    place = re.match(r"Expected .* - at `\$\.?([^`]*)`$", str(error))
    return f"{place[1] or 'it'} is not {reword(str(error))}" if place is not None else str(error)


def _encode_array(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        kind = value.dtype.str[1:] if value.dtype.str[1:] in ("f4", "u1") else "f8"
        return {"shape": list(value.shape), kind: np.ascontiguousarray(value, dtype=_KINDS[kind]).tobytes()}
    raise NotImplementedError(f"cannot send {type(value).__name__}")


def _decode_array(kind: type, value: Any) -> Any:
    """A writable array."""
    if isinstance(value, dict) and len(value) == 2 and "shape" in value:
        for name, dtype in _KINDS.items():
            if name in value:
                return np.frombuffer(value[name], dtype=dtype).reshape(value["shape"]).copy()
    raise NotImplementedError(f"cannot receive {kind}")
