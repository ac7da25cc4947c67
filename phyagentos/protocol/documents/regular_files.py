"""Files that others may have put there: only regular ones are read, none is waited for, and their size is bounded.

A FIFO, a device or a lease of another process never blocks who reads (`O_NONBLOCK`).
"""

import errno
import hashlib
import os
import stat
from pathlib import Path

DOCUMENT_MAX = 16 << 20  # bytes of an authored file or document; the largest rendered ones have a few MB
REQUEST_MAX = 1 << 16  # of a stop request, a heartbeat or a latch
_PART_BYTES = 1 << 16
_FLAGS = os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK | os.O_NOCTTY


class UnfitFileError(OSError):
    """No regular file, or a larger one than is read."""


def open_regular(path: Path | str, *, follow: bool = True) -> tuple[int, os.stat_result]:
    """A descriptor for reading, with `follow` also through a symbolic link; raises OSError, or `UnfitFileError`."""
    try:
        fd = os.open(path, _FLAGS if follow else _FLAGS | os.O_NOFOLLOW)
    except OSError as error:
        if error.errno == errno.ELOOP and not follow:
            raise UnfitFileError("it is a symbolic link; only regular files are read") from error
        raise
    found = os.fstat(fd)
    if not stat.S_ISREG(found.st_mode):
        os.close(fd)
        raise UnfitFileError("it is no regular file, and no other is read")
    return fd, found


def read_open(fd: int, size: int, at_most: int) -> bytes:
    """All bytes of an open file of this size; raises OSError, or `UnfitFileError` above `at_most`."""
    data = os.read(fd, size + 1) if size <= at_most else b""
    while size < len(data) <= at_most and (part := os.read(fd, _PART_BYTES)):
        data += part  # it grew meanwhile, or its file system tells no sizes
    if max(size, len(data)) > at_most:
        raise UnfitFileError(f"it has more than {at_most} bytes; no more are read")
    return data


def read_regular(path: Path | str, at_most: int = DOCUMENT_MAX, *, follow: bool = True) -> bytes:
    """All bytes of a file; raises OSError, or `UnfitFileError`."""
    fd, found = open_regular(path, follow=follow)
    try:
        return read_open(fd, found.st_size, at_most)
    finally:
        os.close(fd)


def hash_regular(path: Path | str) -> str:
    """SHA-256 of a file of any size, which is read part by part; raises OSError, or `UnfitFileError`."""
    with os.fdopen(open_regular(path)[0], "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
