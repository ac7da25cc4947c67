"""How arrays travel between processes: float64, C order, with their shape; hooks for msgspec."""

from typing import Any

import numpy as np


def encode_array(value: Any) -> Any:
    """The `enc_hook` of msgspec for numpy arrays."""
    if isinstance(value, np.ndarray):
        return {"shape": list(value.shape), "f8": np.ascontiguousarray(value, dtype="<f8").tobytes()}
    raise NotImplementedError(f"cannot send {type(value).__name__}")


def decode_array(kind: type, value: Any) -> Any:
    """The `dec_hook` of msgspec for numpy arrays; the result is writable."""
    if isinstance(value, dict) and value.keys() == {"shape", "f8"}:
        return np.frombuffer(value["f8"], dtype="<f8").reshape(value["shape"]).copy()
    raise NotImplementedError(f"cannot receive {kind}")
