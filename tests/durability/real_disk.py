"""A real file system on a loop device that can lose its power: ext4's own shutdown call, as file-system tests use it.

`EXT4_IOC_SHUTDOWN` without a log flush stops the file system on the spot: what is only in the page cache, or only in a
transaction that was not committed, is gone; the next mount replays the journal as after a power cut. It needs root, a
loop device and `mkfs.ext4`; where they are missing, `disk_model` stands alone.
"""

import fcntl
import os
import shutil
import struct
import subprocess
import tempfile
from functools import cache
from pathlib import Path

EXT4_IOC_SHUTDOWN = 0x8004587D  # _IOR('X', 125, __u32)
NO_LOG_FLUSH = 2
SIZE_BYTES = 64 << 20
OPTIONS = {"ordered": "data=ordered", "writeback": "data=writeback"}


class RealDisk:
    """An ext4 file system in a file; use it in a `with` statement.

    Args:
        folder: For the file and the mount point.
        options: Of the mount.
    """

    def __init__(self, folder: Path, options: str) -> None:
        self.root = folder / "mounted"
        self._file, self._options = folder / "disk.img", options

    def __enter__(self) -> "RealDisk":
        self.root.mkdir()
        with self._file.open("wb") as file:
            file.truncate(SIZE_BYTES)
        run("mkfs.ext4", "-q", "-F", str(self._file))
        self._mount()
        return self

    def __exit__(self, *_: object) -> None:
        run("umount", str(self.root))
        self._file.unlink()
        self.root.rmdir()

    def cut(self) -> None:
        """The power goes. Whoever writes now gets an error."""
        fd = os.open(self.root, os.O_RDONLY)
        try:
            fcntl.ioctl(fd, EXT4_IOC_SHUTDOWN, struct.pack("I", NO_LOG_FLUSH))
        finally:
            os.close(fd)

    def restore(self) -> None:
        """The power comes back; nobody may hold a file open any more."""
        run("umount", str(self.root))
        self._mount()

    def _mount(self) -> None:
        run("mount", "-o", f"loop,{self._options}", str(self._file), str(self.root))


def run(*command: str) -> None:
    subprocess.run(command, check=True, capture_output=True, timeout=60)


@cache
def can_cut_power() -> bool:
    """Whether this machine lets us: tried, not guessed."""
    if os.geteuid() != 0 or not all(map(shutil.which, ("mkfs.ext4", "mount", "umount"))):
        return False
    folder = Path(tempfile.mkdtemp(prefix="real-disk-"))
    try:
        with RealDisk(folder, OPTIONS["ordered"]) as disk:
            disk.cut()
    except (OSError, subprocess.SubprocessError):
        return False
    else:
        return True
    finally:
        shutil.rmtree(folder, ignore_errors=True)
