"""Two calls of Linux that the standard library lacks: swap two files, and find whether a file is open for writing.

`renameat2(RENAME_EXCHANGE)` publishes a rendering and returns the former file in one step, so that no edit falls
between a look and a rename. A read lease is granted only where no process has a file open for writing.
"""

import ctypes
import errno
import fcntl
import os
import signal
from pathlib import Path

_AT_FDCWD = -100
_NOREPLACE = 1
_EXCHANGE = 2
_UNSUPPORTED = frozenset({errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP})
_RENAMEAT2 = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)


class ExchangeUnsupported(OSError):
    """The system or this file system cannot swap two files."""


def exchange(one: Path, other: Path) -> None:
    """Swap two files; raises FileNotFoundError or ExchangeUnsupported."""
    _rename(one, other, _EXCHANGE)


def rename_new(source: Path, destination: Path) -> None:
    """Rename to a free name; raises FileExistsError where it is taken, or ExchangeUnsupported."""
    _rename(source, destination, _NOREPLACE)


def may_be_written(fd: int) -> bool | None:
    """Whether a process has this file (opened for reading only) open for writing; None where that is unknown."""
    try:
        fcntl.fcntl(fd, fcntl.F_SETSIG, signal.SIGURG)  # ignored by default; the usual SIGIO would end the process
        fcntl.fcntl(fd, fcntl.F_SETLEASE, fcntl.F_RDLCK)
    except BlockingIOError:
        return True
    except OSError:  # not the owner, or a file system without leases
        return None
    fcntl.fcntl(fd, fcntl.F_SETLEASE, fcntl.F_UNLCK)
    return False


def _rename(source: Path, destination: Path, flags: int) -> None:
    if _RENAMEAT2 is None:
        raise ExchangeUnsupported(errno.ENOSYS, os.strerror(errno.ENOSYS))
    if _RENAMEAT2(_AT_FDCWD, os.fsencode(source), _AT_FDCWD, os.fsencode(destination), ctypes.c_uint(flags)) == 0:
        return
    code = ctypes.get_errno()
    kind = ExchangeUnsupported if code in _UNSUPPORTED else OSError  # OSError becomes the subclass of its code
    raise kind(code, os.strerror(code), str(source), None, str(destination))
