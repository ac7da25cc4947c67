"""Arrays of the evidence: NPZ files that `numpy.load` reads, encoded in one go.

`numpy.savez` writes member by member, which for many small arrays costs more than all else. Here everything but numbers
and checksums is made once for each kind of file. The bytes depend on the arrays alone: they hold no time.
"""

import math
import struct
import zipfile
import zlib
from functools import lru_cache
from io import BytesIO
from typing import Any, NamedTuple

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

_LOCAL_BEFORE, _LOCAL_BEHIND = struct.Struct("<4s5H"), struct.Struct("<2I2H")
_CENTRAL_BEFORE, _CENTRAL_BEHIND = struct.Struct("<4s6H"), struct.Struct("<2I5H2I")
_CRC = struct.Struct("<I")
_LOCAL_BYTES = _LOCAL_BEFORE.size + _CRC.size + _LOCAL_BEHIND.size
_CENTRAL_BYTES = _CENTRAL_BEFORE.size + _CRC.size + _CENTRAL_BEHIND.size
_END = struct.Struct("<4s4H2IH")
_VERSION = 20  # 2.0: what a reader must support
_MIDNIGHT_1980 = (0, 33)  # time and date of a member, in the format of MS-DOS


def encode_arrays(arrays: dict[str, NDArray[Any]]) -> bytes:
    """The bytes of an uncompressed `.npz` of numeric arrays, at most 4 GiB in all."""
    form = _make_form(tuple([(name, array.dtype, array.shape) for name, array in arrays.items()]))
    parts: list[bytes] = []
    directory: list[bytes] = []
    for array, member in zip(arrays.values(), form.members, strict=True):
        data = array.tobytes()
        crc = _CRC.pack(zlib.crc32(data, member.crc))
        parts += (member.local_before, crc, member.local_behind, data)
        directory += (member.central_before, crc, member.central_behind)
    return b"".join((*parts, *directory, form.end))


def decode_arrays(data: bytes) -> dict[str, NDArray[Any]]:
    """The arrays of an `.npz`, by name; executes nothing; raises ValueError for other bytes."""
    if not zipfile.is_zipfile(BytesIO(data)):
        raise ValueError(f"{len(data)} bytes that are no NPZ")
    try:
        with np.load(BytesIO(data)) as arrays:
            return dict(arrays)
    except (ValueError, OSError, EOFError, KeyError, NotImplementedError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"{len(data)} bytes that are no NPZ: {error}") from error


class _Member(NamedTuple):
    """The bytes around one array and its checksum; `crc` is that of the `.npy` head, where the checksum goes on."""

    crc: int
    local_before: bytes
    local_behind: bytes
    central_before: bytes
    central_behind: bytes


class _Form(NamedTuple):
    """An archive without its numbers."""

    members: tuple[_Member, ...]
    end: bytes


@lru_cache(maxsize=256)
def _make_form(kinds: "tuple[tuple[str, np.dtype[Any], tuple[int, ...]], ...]") -> _Form:
    """All that archives of these names, types and shapes have in common."""
    members: list[_Member] = []
    offset = size = 0
    for key, dtype, shape in kinds:
        name = f"{key}.npy".encode()
        head = _encode_header(dtype, shape)
        length = len(head) + dtype.itemsize * math.prod(shape)
        before = (_VERSION, 0, 0, *_MIDNIGHT_1980)
        behind = (length, length, len(name), 0)
        members.append(
            _Member(
                crc=zlib.crc32(head),
                local_before=_LOCAL_BEFORE.pack(b"PK\x03\x04", *before),
                local_behind=_LOCAL_BEHIND.pack(*behind) + name + head,
                central_before=_CENTRAL_BEFORE.pack(b"PK\x01\x02", _VERSION, *before),
                central_behind=_CENTRAL_BEHIND.pack(*behind, 0, 0, 0, 0, offset) + name,
            )
        )
        offset += _LOCAL_BYTES + len(name) + length
        size += _CENTRAL_BYTES + len(name)
    end = _END.pack(b"PK\x05\x06", 0, 0, len(kinds), len(kinds), size, offset, 0)
    return _Form(tuple(members), end)


def _encode_header(dtype: "np.dtype[Any]", shape: tuple[int, ...]) -> bytes:
    """The head of a `.npy` file, format 1.0."""
    head = BytesIO()
    npy.write_array_header_1_0(head, {"descr": npy.dtype_to_descr(dtype), "fortran_order": False, "shape": shape})
    return head.getvalue()
