"""Zip files that may come from elsewhere: what they unpack to is known to be small before anything is unpacked.

Only deflated and stored members are read, and never more of one than it declares.
"""

import os
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

from phyagentos.protocol.documents.regular_files import open_regular

FILE_MAX, MEMBER_MAX = 1 << 31, 1 << 28  # bytes of a packed file; unpacked, of a member and of all arrays of an NPZ
LIST_MAX = 1 << 22  # bytes of the list of members of a file
PIXELS_MAX = 1 << 26  # of a picture
_END, _END_OF_LONG, _END_BYTES, _END_MAX = b"PK\5\6", b"PK\6\7", 22, 22 + (1 << 16)
_PNG = b"\x89PNG\r\n\x1a\n"
_UNFIT = (ValueError, OSError, EOFError, NotImplementedError, RuntimeError, zipfile.BadZipFile, zlib.error)


class PackedFile:
    """A zip file that is open for reading."""

    def __init__(self, file: zipfile.ZipFile) -> None:
        self._file = file

    @property
    def names(self) -> list[str]:
        """Of its members."""
        return self._file.namelist()

    def read(self, name: str) -> bytes:
        """A member, unpacked; raises KeyError without one, ValueError where it cannot or may not be unpacked."""
        member = self._file.getinfo(name)
        if member.file_size > MEMBER_MAX:
            raise ValueError(f"{name} unpacks to {member.file_size} bytes; at most {MEMBER_MAX} are read")
        if member.compress_type not in {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}:
            raise ValueError(f"{name} is packed by method {member.compress_type}; expected a deflated or stored member")
        try:
            with self._file.open(member) as opened:
                data = opened.read(member.file_size)
        except _UNFIT as error:
            raise ValueError(f"{name} cannot be unpacked: {error}") from error
        if len(data) != member.file_size:
            raise ValueError(f"{name} unpacks to {len(data)} bytes instead of {member.file_size}")
        return data


@contextmanager
def open_packed(source: Path | bytes) -> Iterator[PackedFile]:
    """A zip file, from its path or its bytes; raises OSError, ValueError for other bytes, FileNotFoundError."""
    with BytesIO(source) if isinstance(source, bytes) else os.fdopen(open_regular(source)[0], "rb") as opened:
        if (size := opened.seek(0, os.SEEK_END)) > FILE_MAX:
            raise ValueError(f"it has {size} bytes; at most {FILE_MAX} are read")
        opened.seek(max(0, size - _END_MAX))
        if not _is_listed_briefly(opened.read()):
            raise ValueError(f"its list of members has more than {LIST_MAX} bytes")
        try:
            file = zipfile.ZipFile(opened)
        except (zipfile.BadZipFile, NotImplementedError, ValueError) as error:
            raise ValueError(str(error)) from error
        with file:
            yield PackedFile(file)


def _is_listed_briefly(end: bytes) -> bool:
    """Whether the list of members, each of which takes memory when it is opened, is short, by the end of the file."""
    at = len(end) - _END_BYTES
    if end[at : at + 4] != _END or any(end[-2:]):  # then a comment stands behind it
        at = end.rfind(_END)
    is_long = at >= 20 and end[at - 20 : at - 16] == _END_OF_LONG
    return not is_long and int.from_bytes(end[at + 12 : at + 16], "little") <= LIST_MAX


def check_picture(data: bytes) -> bytes:
    """The same bytes of a PNG that is not too large to be decoded; raises ValueError for others."""
    width, height = int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    if not data.startswith(_PNG) or not 0 < width * height <= PIXELS_MAX:
        raise ValueError(f"no PNG of at most {PIXELS_MAX} pixels")
    return data
