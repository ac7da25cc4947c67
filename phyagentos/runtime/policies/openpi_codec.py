"""openpi's messages: msgpack with arrays as maps of `__ndarray__`, `data`, `dtype` and `shape`; nothing is unpickled.

The format is that of `msgpack_numpy` in https://github.com/Physical-Intelligence/openpi (packages/openpi-client).
"""

import math
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np

from phyagentos.errors import ExecutionError

PROMPT, ACTIONS = "prompt", "actions"  # keys of an observation, and of an answer
EXTENSION = "phyagentos"  # a key of metadata, observations and answers: what this project's own server takes and gives
KINDS = "biuf"  # of element types: booleans, whole numbers, floats
ITEMS_MAX = 2**24  # elements of one array
DEPTH_MAX = 8
_BROKEN = (msgspec.MsgspecError, ValueError, TypeError, KeyError, RecursionError)


def encode(message: Mapping[str, Any]) -> bytes:
    """One message; raises TypeError for what has no form in it."""
    return msgspec.msgpack.encode(message, enc_hook=_pack)


def decode(data: bytes) -> dict[Any, Any]:
    """One message, a map; raises ExecutionError `MALFORMED`, which says what is wrong with it."""
    try:
        message = _unpack(msgspec.msgpack.decode(data), DEPTH_MAX)
        if not isinstance(message, dict):
            raise TypeError(f"found {type(message).__name__}, expected a map")
    except _BROKEN as error:
        raise ExecutionError("MALFORMED", f"{len(data)} bytes that are no openpi message: {error}") from error
    return message


def _pack(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.dtype.kind in KINDS:
        whole = np.ascontiguousarray(value)
        return {b"__ndarray__": True, b"data": whole.tobytes(), b"dtype": value.dtype.str, b"shape": value.shape}
    if isinstance(value, np.generic) and value.dtype.kind in KINDS:
        return {b"__npgeneric__": True, b"data": value.item(), b"dtype": value.dtype.str}
    raise TypeError(f"cannot send {type(value).__name__}")


def _unpack(value: Any, depth: int) -> Any:
    if depth < 0:
        raise ValueError(f"deeper than {DEPTH_MAX} maps")
    if isinstance(value, list):
        return [_unpack(each, depth - 1) for each in value]
    if not isinstance(value, dict):
        return value
    named = {key.encode() if isinstance(key, str) else key: each for key, each in value.items()}  # some write text
    if b"__ndarray__" in named:
        return _read_array(named[b"data"], _read_type(named[b"dtype"]), named[b"shape"])
    if b"__npgeneric__" in named:
        return _read_type(named[b"dtype"]).type(named[b"data"])
    return {
        key.decode(errors="replace") if isinstance(key, bytes) else key: _unpack(each, depth - 1)
        for key, each in value.items()
    }


def _read_type(text: Any) -> "np.dtype[Any]":
    if not isinstance(text, str) or len(text) > 4 or np.dtype(text).kind not in KINDS:
        raise ValueError(f"an array of the type {text!r:.40}; expected booleans or numbers")
    return np.dtype(text)


def _read_array(data: Any, dtype: "np.dtype[Any]", shape: Any) -> Any:
    if not isinstance(shape, list) or not all(isinstance(each, int) and each >= 0 for each in shape):
        raise ValueError(f"an array of the shape {shape!r:.60}")
    count = math.prod(shape)
    if count > ITEMS_MAX or not isinstance(data, bytes) or count * dtype.itemsize != len(data):
        held = f"{len(data)} bytes" if isinstance(data, bytes) else type(data).__name__
        raise ValueError(f"an array of the shape {shape!r:.60} and type {dtype}, of {held}")
    return np.frombuffer(data, dtype=dtype).reshape(shape).copy()
