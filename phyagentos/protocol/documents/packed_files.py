"""Zip files that may come from elsewhere: what they unpack to is known to be small before anything is unpacked.

Only deflated and stored members are read, and never more of one than it declares.
"""

import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

FILE_MAX, MEMBER_MAX = 1 << 31, 1 << 28  # bytes of a packed file; unpacked, of a member and of all arrays of an NPZ
PIXELS_MAX = 1 << 26  # of a picture
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
    if isinstance(source, Path) and source.stat().st_size > FILE_MAX:
        raise ValueError(f"it has {source.stat().st_size} bytes; at most {FILE_MAX} are read")
    if isinstance(source, Path) and not source.is_file():
        raise ValueError("it is no regular file")
    try:
        file = zipfile.ZipFile(BytesIO(source) if isinstance(source, bytes) else source)
    except (zipfile.BadZipFile, NotImplementedError, ValueError) as error:
        raise ValueError(str(error)) from error
    with file:
        yield PackedFile(file)


def check_picture(data: bytes) -> bytes:
    """The same bytes of a PNG that is not too large to be decoded; raises ValueError for others."""
    width, height = int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    if not data.startswith(_PNG) or not 0 < width * height <= PIXELS_MAX:
        raise ValueError(f"no PNG of at most {PIXELS_MAX} pixels")
    return data
