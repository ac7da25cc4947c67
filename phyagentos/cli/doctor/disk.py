"""Checks of the folder in which workspaces will stand: space, durability, locks, file events, its clock."""

import ctypes
import fcntl
import os
import shutil
import statistics
import tempfile
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

from phyagentos.cli.doctor.finding import Finding, Grade
from phyagentos.clock import Clock
from phyagentos.store.watch import Watch

FREE_MIN_BYTES = 1 << 30
SYNCS = 100
SYNC_P99_MAX_MS = 20.0  # beyond it, a claim takes longer than a control period
SKEW_MAX_S = 2.0
EVENT_WAIT_S = 2.0
LOCAL = frozenset({"ext2", "ext3", "ext4", "xfs", "btrfs", "zfs", "f2fs", "overlay", "tmpfs"})
_EXCHANGE = 2  # RENAME_EXCHANGE of renameat2(2)
_AT_FDCWD = -100


def check_space(folder: Path, clock: Clock) -> Finding:
    """Free bytes."""
    del clock
    free = shutil.disk_usage(folder).free
    found = f"{free / 1e9:.1f} GB free"
    if free < FREE_MIN_BYTES:
        return Finding("space", Grade.WEAK, found, "A goal leaves some megabytes of evidence: make room.")
    return Finding("space", Grade.FINE, found)


def check_file_system(folder: Path, clock: Clock) -> Finding:
    """Whether it is a local one, on which locks and appends are what they promise."""
    del clock
    kind = find_file_system(folder)
    if kind in LOCAL:
        return Finding("file system", Grade.FINE, kind)
    fix = "Put workspaces on a local disk: on shared file systems two writers were measured to corrupt a log."
    return Finding("file system", Grade.WEAK, kind or "unknown", fix)


def check_syncs(folder: Path, clock: Clock) -> Finding:
    """How long a record needs to reach the disk."""
    spans_ms = []
    with tempfile.NamedTemporaryFile(dir=folder) as file:
        for _ in range(SYNCS):
            begin_s = clock.now_s()
            os.write(file.fileno(), b"x" * 512)
            os.fdatasync(file.fileno())
            spans_ms.append(1e3 * (clock.now_s() - begin_s))
    p99_ms = statistics.quantiles(spans_ms, n=100)[98]
    found = f"append and fdatasync: median {statistics.median(spans_ms):.2f} ms, p99 {p99_ms:.2f} ms"
    if p99_ms > SYNC_P99_MAX_MS:
        return Finding("durability", Grade.WEAK, found, "Every transition waits for the disk: use a faster one.")
    return Finding("durability", Grade.FINE, found)


def check_locks(folder: Path, clock: Clock) -> Finding:
    """Whether flock keeps a second holder out."""
    del clock
    with tempfile.NamedTemporaryFile(dir=folder) as first, Path(first.name).open("rb") as second:
        fcntl.flock(first.fileno(), fcntl.LOCK_EX)
        try:
            fcntl.flock(second.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return Finding("locks", Grade.FINE, "flock excludes")
    return Finding("locks", Grade.BROKEN, "flock lets two in", "Put workspaces on a local disk.")


def check_exchange(folder: Path, clock: Clock) -> Finding:
    """Whether two names can be exchanged in one step, which keeps a person's edit from being lost."""
    del clock
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        one, two = (os.fsencode(Path(scratch) / name) for name in ("one", "two"))
        for name in (one, two):
            Path(os.fsdecode(name)).touch()
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.renameat2(_AT_FDCWD, one, _AT_FDCWD, two, _EXCHANGE) == 0:
            return Finding("exchange", Grade.FINE, "names are exchanged in one step")
        reason = os.strerror(ctypes.get_errno())
    return Finding("exchange", Grade.WEAK, reason, "Edit documents with `paos edit`, which takes the lock.")


def check_events(folder: Path, clock: Clock) -> Finding:
    """Whether a new file wakes a waiting process."""
    with tempfile.TemporaryDirectory(dir=folder) as scratch, Watch([Path(scratch)], clock=clock) as watch:
        (Path(scratch) / "new").touch()
        if watch.is_event_driven and watch.wait(EVENT_WAIT_S):
            return Finding("file events", Grade.FINE, "inotify wakes")
    fix = "Sessions are noticed by polling. Raise fs.inotify.max_user_instances and max_user_watches (sysctl)."
    return Finding("file events", Grade.WEAK, "inotify is not to be had here", fix)


def check_clock(folder: Path, clock: Clock) -> Finding:
    """Whether the folder's clock is the machine's."""
    with tempfile.NamedTemporaryFile(dir=folder) as file:
        written_s = os.fstat(file.fileno()).st_mtime
        skew_s = abs(datetime.fromisoformat(clock.wall_iso()).timestamp() - written_s)
    if skew_s > SKEW_MAX_S:
        fix = "The file server's clock differs from this machine's: synchronise both (chrony, systemd-timesyncd)."
        return Finding("clock", Grade.WEAK, f"{skew_s:.1f} s between files and machine", fix)
    return Finding("clock", Grade.FINE, "files are stamped with this machine's time")


def find_file_system(folder: Path) -> str:
    """Kind of the file system that holds `folder`, empty where the system does not tell."""
    best, kind = "", ""
    try:
        lines = Path("/proc/self/mounts").read_text(encoding="utf-8").splitlines()
    except OSError:
        return ""
    for line in lines:
        _, mount, found, *_ = line.split()
        mount = mount.encode().decode("unicode_escape")
        if folder.resolve().is_relative_to(mount) and len(mount) >= len(best):
            best, kind = mount, found
    return kind


CHECKS: tuple[Callable[[Path, Clock], Finding], ...] = (
    check_space,
    check_file_system,
    check_syncs,
    check_locks,
    check_exchange,
    check_events,
    check_clock,
)
