"""Arrays of the evidence: NPZ files that `numpy.load` reads, encoded in one go.

`numpy.savez` builds the archive through `zipfile`, member by member; for a bundle of many small arrays that costs more
than everything else that is written. The bytes here depend on the arrays alone: no time of the day is in them.
"""

import struct
import zlib
from functools import lru_cache
from io import BytesIO
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

_LOCAL = struct.Struct("<4s5H3I2H")
_CENTRAL = struct.Struct("<4s6H3I5H2I")
_END = struct.Struct("<4s4H2IH")
_VERSION = 20  # 2.0: what a reader must support
_MIDNIGHT_1980 = (0, 33)  # time and date of a member, in the format of MS-DOS


def encode_arrays(arrays: dict[str, NDArray[Any]]) -> bytes:
    """The bytes of an uncompressed `.npz`, at most 4 GiB in all.

    Args:
        arrays: By name; of numbers.
    """
    parts: list[bytes] = []
    directory: list[bytes] = []
    offset = 0
    for key, array in arrays.items():
        name = f"{key}.npy".encode()
        plain = np.ascontiguousarray(array).reshape(np.shape(array))
        data = _encode_header(plain.dtype, plain.shape) + plain.tobytes()
        facts = (_VERSION, 0, 0, *_MIDNIGHT_1980, zlib.crc32(data), len(data), len(data), len(name), 0)
        directory += (_CENTRAL.pack(b"PK\x01\x02", _VERSION, *facts, 0, 0, 0, 0, offset), name)
        head = _LOCAL.pack(b"PK\x03\x04", *facts)
        parts += (head, name, data)
        offset += len(head) + len(name) + len(data)
    size = sum(map(len, directory))
    end = _END.pack(b"PK\x05\x06", 0, 0, len(arrays), len(arrays), size, offset, 0)
    return b"".join((*parts, *directory, end))


@lru_cache(maxsize=256)
def _encode_header(dtype: "np.dtype[Any]", shape: tuple[int, ...]) -> bytes:
    """The head of a `.npy` file, format 1.0."""
    head = BytesIO()
    npy.write_array_header_1_0(head, {"descr": npy.dtype_to_descr(dtype), "fortran_order": False, "shape": shape})
    return head.getvalue()
