"""Arrays of the evidence: NPZ files as numpy writes and reads them; none is larger than its own bytes."""

from io import BytesIO
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phyagentos.protocol.documents.packed_files import MEMBER_MAX, open_packed
from phyagentos.protocol.documents.regular_files import read_regular


def encode_arrays(arrays: dict[str, NDArray[Any]]) -> bytes:
    """The bytes of an uncompressed `.npz`; they depend on the arrays alone, since members hold no time."""
    file = BytesIO()
    np.savez(file, allow_pickle=False, **arrays)
    return file.getvalue()


def decode_arrays(data: bytes) -> dict[str, NDArray[Any]]:
    """The arrays of an `.npz`, by name; executes nothing; raises ValueError for other bytes."""
    left, arrays = MEMBER_MAX, {}
    try:
        with open_packed(data) as file:
            for name in file.names:
                member = file.read(name)
                if (left := left - len(member)) < 0:
                    raise ValueError(f"it unpacks to more than {MEMBER_MAX} bytes")
                arrays[name.removesuffix(".npy")] = decode_array(member)
    except (KeyError, ValueError) as error:
        raise ValueError(f"{len(data)} bytes that are no NPZ: {error}") from error
    return arrays


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of an `.npz` file, by name; raises OSError, or ValueError for other bytes."""
    return decode_arrays(read_regular(path, MEMBER_MAX + (MEMBER_MAX >> 4)))


def decode_array(data: bytes) -> NDArray[Any]:
    """The array of a `.npy`, which is as large as its own bytes; raises ValueError for other bytes."""
    stream = BytesIO(data)
    version = np.lib.format.read_magic(stream)
    read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}.get(version)
    if read is None:
        raise ValueError(f"version {version} of NPY; expected 1.0 or 2.0")
    shape, _, dtype = read(stream)
    n_bytes = prod(map(int, shape)) * max(dtype.itemsize, 1)
    if n_bytes > len(data) - stream.tell() or min(shape, default=0) < 0:
        raise ValueError(f"an array of shape {shape} and {n_bytes} bytes in {len(data)}")
    return np.asarray(np.load(BytesIO(data), allow_pickle=False))
