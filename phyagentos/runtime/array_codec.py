"""How arrays travel between processes: C order, with their shape; hooks for msgspec.

Numbers travel as float64; pictures (uint8) and depth (float32) keep their type, since they are large.
"""

from typing import Any

import numpy as np

_KINDS = {"f8": "<f8", "f4": "<f4", "u1": "|u1"}


def encode_array(value: Any) -> Any:
    """The `enc_hook` of msgspec for numpy arrays."""
    if isinstance(value, np.ndarray):
        kind = value.dtype.str[1:] if value.dtype.str[1:] in ("f4", "u1") else "f8"
        return {"shape": list(value.shape), kind: np.ascontiguousarray(value, dtype=_KINDS[kind]).tobytes()}
    raise NotImplementedError(f"cannot send {type(value).__name__}")


def decode_array(kind: type, value: Any) -> Any:
    """The `dec_hook` of msgspec for numpy arrays; the result is writable."""
    if isinstance(value, dict) and len(value) == 2 and "shape" in value:
        for name, dtype in _KINDS.items():
            if name in value:
                return np.frombuffer(value[name], dtype=dtype).reshape(value["shape"]).copy()
    raise NotImplementedError(f"cannot receive {kind}")
