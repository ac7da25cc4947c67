"""Arrays of the evidence: NPZ files as numpy writes and reads them."""

import zipfile
import zlib
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray


def encode_arrays(arrays: dict[str, NDArray[Any]]) -> bytes:
    """The bytes of an uncompressed `.npz`; they depend on the arrays alone, since members hold no time."""
    file = BytesIO()
    np.savez(file, allow_pickle=False, **arrays)
    return file.getvalue()


def decode_arrays(data: bytes) -> dict[str, NDArray[Any]]:
    """The arrays of an `.npz`, by name; executes nothing; raises ValueError for other bytes."""
    if not zipfile.is_zipfile(BytesIO(data)):
        raise ValueError(f"{len(data)} bytes that are no NPZ")
    try:
        with np.load(BytesIO(data)) as arrays:
            return dict(arrays)
    except (ValueError, OSError, EOFError, KeyError, NotImplementedError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"{len(data)} bytes that are no NPZ: {error}") from error
