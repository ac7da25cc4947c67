"""Whether this machine can run what the project promises, and what to do where it cannot."""

import contextlib
import fcntl
import importlib.metadata
import os
import platform
import shutil
import socket
import tempfile
from collections.abc import Callable, Iterator
from datetime import datetime
from enum import StrEnum
from pathlib import Path

import msgspec
from packaging.requirements import Requirement

from phyagentos.assembly import graphics
from phyagentos.clock import Clock, SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.store.shared_file import exchange
from phyagentos.store.sync_times import measure_sync
from phyagentos.store.watch import Watch

FREE_MIN_BYTES = 1 << 30
SYNC_P99_MAX_MS = 20.0  # beyond it, a claim takes longer than a control period
SKEW_MAX_S = 2.0
EVENT_WAIT_S = 2.0
LOCAL = frozenset({"ext2", "ext3", "ext4", "xfs", "btrfs", "zfs", "f2fs", "overlay", "tmpfs"})
PRIORITY = 10
PACKAGES_OF_DEBIAN = "libegl1 libegl-mesa0 libgl1-mesa-dri"


class Grade(StrEnum):
    """How good it is."""

    FINE = "fine"
    """As it should be."""
    WEAK = "weak"
    """All works, something is slower or missing."""
    BROKEN = "broken"
    """A promise cannot be kept here."""


class MachineFinding(msgspec.Struct, frozen=True):
    """One line of the report; `fix` is empty where all is fine."""

    subject: str
    grade: Grade
    found: str
    fix: str = ""

    @classmethod
    def weigh(cls, subject: str, found: str, fix: str, *, is_fine: bool, bad: Grade = Grade.WEAK) -> "MachineFinding":
        """Fine, or else `bad` with its fix."""
        return cls(subject, Grade.FINE, found) if is_fine else cls(subject, bad, found, fix)


def examine_machine(folder: Path) -> tuple[MachineFinding, ...]:
    """Every check; scratch files are made and removed in `folder`. Raises DefinitionError `UNKNOWN_NAME`."""
    if not folder.is_dir():
        raise DefinitionError.of("UNKNOWN_NAME", str(folder), expected="a folder that exists", kind="folder")
    return tuple(iter_findings(folder, SystemClock()))


def iter_findings(folder: Path, clock: Clock) -> Iterator[MachineFinding]:
    """Every check, one after the other; scratch files are made and removed in `folder`."""
    yield check_python()
    yield check_packages()
    yield check_graphics()
    checks = (check_space, check_file_system, check_syncs, check_locks, check_exchange, check_events, check_clock)
    for check in checks:
        try:
            yield check(folder, clock)
        except OSError as error:
            subject = check.__name__.removeprefix("check_").replace("_", " ")
            yield MachineFinding(subject, Grade.BROKEN, str(error), f"Make {folder} a folder with room to write to.")
    yield check_scheduling()
    yield check_ports()


def warm_kernels(clock: Clock, on_kernel: Callable[[str], None]) -> MachineFinding:
    """Compile what numba compiles and does not keep yet; each kernel is named as it begins."""
    from phyagentos.assembly.kernels import compile_kernels

    began_s, names = clock.now_s(), list[str]()

    def note(name: str) -> None:
        names.append(name)
        on_kernel(name)

    try:
        folder = compile_kernels(Library.open(), note)
    except RuntimeError as error:
        if "cannot cache" not in str(error):
            raise
        fix = "Set NUMBA_CACHE_DIR to a folder that you may write to: no process of a run starts without one."
        return MachineFinding("kernels", Grade.BROKEN, str(error), fix)
    return MachineFinding(
        "kernels", Grade.FINE, f"{len(names)} compiled in {clock.now_s() - began_s:.1f} s, kept in {folder}"
    )


def check_python() -> MachineFinding:
    """Version and processors."""
    count = len(os.sched_getaffinity(0))
    found = f"Python {platform.python_version()}, {count} processors"
    fix = "Two processors let the world and the planner work side by side."
    return MachineFinding.weigh("python", found, fix, is_fine=count > 1)


def check_packages() -> MachineFinding:
    """Every requirement of this project, extras excepted."""
    bad: list[str] = []
    wanted = [Requirement(text) for text in importlib.metadata.requires("phyagentos") or ()]
    core = [each for each in wanted if each.marker is None or each.marker.evaluate({"extra": ""})]
    for requirement in core:
        try:
            version = importlib.metadata.version(requirement.name)
        except importlib.metadata.PackageNotFoundError:
            bad.append(f"{requirement.name} is missing")
            continue
        if not requirement.specifier.contains(version, prereleases=True):
            bad.append(f"{requirement.name} {version}, needs {requirement.specifier}")
    found, fix = (
        "; ".join(bad) or f"{len(core)} packages as required",
        "Install the project again: pip install . in the checkout, or the path of the wheel.",
    )
    return MachineFinding.weigh("packages", found, fix, is_fine=not bad, bad=Grade.BROKEN)


def check_graphics() -> MachineFinding:
    """Whether a run draws a picture here, tried in a process with its environment."""
    named, fix = graphics.find_named(), f"Unset {graphics.NAME}: runs then draw by {graphics.ORDINARY}."
    try:
        graphics.require_graphics()
    except DefinitionError as refused:
        return MachineFinding("graphics", Grade.BROKEN, f"no run starts with {refused.problems[0].found}", fix)
    if named in graphics.NONE:
        return MachineFinding("graphics", Grade.WEAK, f"{graphics.NAME}={named}: no pictures", fix)
    fix = f"Runs work without pictures. On Debian: apt-get install {PACKAGES_OF_DEBIAN}."
    if not graphics.can_draw():
        return MachineFinding("graphics", Grade.WEAK, graphics.explain_unfit(), fix)
    return MachineFinding("graphics", Grade.FINE, f"pictures by {named}")


def check_space(folder: Path, clock: Clock) -> MachineFinding:
    """Free bytes."""
    free = shutil.disk_usage(folder).free
    fix = "A goal leaves some megabytes of evidence: make room."
    return MachineFinding.weigh("space", f"{free / 1e9:.1f} GB free", fix, is_fine=free >= FREE_MIN_BYTES)


def check_file_system(folder: Path, clock: Clock) -> MachineFinding:
    """Whether it is a local one, on which locks and appends are what they promise."""
    kind = find_file_system(folder)
    fix = "Put workspaces on a local disk: on shared file systems two writers were measured to corrupt a log."
    return MachineFinding.weigh("file system", kind or "unknown", fix, is_fine=kind in LOCAL)


def check_syncs(folder: Path, clock: Clock) -> MachineFinding:
    """How long a record needs to reach the disk."""
    times = measure_sync(folder, clock)
    found = f"append and fdatasync: median {times.p50_ms:.2f} ms, p99 {times.p99_ms:.2f} ms"
    fix = "Every transition waits for the disk: use a faster one."
    return MachineFinding.weigh("durability", found, fix, is_fine=times.p99_ms <= SYNC_P99_MAX_MS)


def check_locks(folder: Path, clock: Clock) -> MachineFinding:
    """Whether flock keeps a second holder out."""
    with tempfile.NamedTemporaryFile(dir=folder) as first, Path(first.name).open("rb") as second:
        fcntl.flock(first.fileno(), fcntl.LOCK_EX)
        try:
            fcntl.flock(second.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return MachineFinding("locks", Grade.FINE, "flock excludes")
    return MachineFinding("locks", Grade.BROKEN, "flock lets two in", "Put workspaces on a local disk.")


def check_exchange(folder: Path, clock: Clock) -> MachineFinding:
    """Whether two names can be exchanged in one step, which keeps a person's edit from being lost."""
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        one, two = Path(scratch) / "one", Path(scratch) / "two"
        one.touch()
        two.touch()
        try:
            exchange(one, two)
        except OSError as error:
            fix = "Edit documents with `paos edit`, which takes the lock."
            return MachineFinding("exchange", Grade.WEAK, str(error.strerror), fix)
    return MachineFinding("exchange", Grade.FINE, "names are exchanged in one step")


def check_events(folder: Path, clock: Clock) -> MachineFinding:
    """Whether a new file wakes a waiting process."""
    with tempfile.TemporaryDirectory(dir=folder) as scratch, Watch([Path(scratch)], clock=clock) as watch:
        (Path(scratch) / "new").touch()
        is_woken = bool(watch.is_event_driven and watch.wait(EVENT_WAIT_S))
    fix = "Sessions are noticed by polling. Raise fs.inotify.max_user_instances and max_user_watches (sysctl)."
    found = "inotify wakes" if is_woken else "inotify is not to be had here"
    return MachineFinding.weigh("file events", found, fix, is_fine=is_woken)


def check_clock(folder: Path, clock: Clock) -> MachineFinding:
    """Whether the folder's clock is the machine's."""
    with tempfile.NamedTemporaryFile(dir=folder) as file:
        written_s = os.fstat(file.fileno()).st_mtime
        skew_s = abs(datetime.fromisoformat(clock.wall_iso()).timestamp() - written_s)
    fix = "The file server's clock differs from this machine's: synchronise both (chrony, systemd-timesyncd)."
    return MachineFinding.weigh("clock", f"{skew_s:.1f} s between files and machine", fix, is_fine=skew_s <= SKEW_MAX_S)


def find_file_system(folder: Path) -> str:
    """Kind of the file system that holds `folder`, empty where unknown."""
    mounts = [("", "")]
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/mounts").read_text(encoding="utf-8").splitlines():
            _, mount, kind, *_ = line.split()
            mount = mount.encode().decode("unicode_escape")
            mounts += [(mount, kind)] if folder.resolve().is_relative_to(mount) else []
    return max(reversed(mounts), key=lambda found: len(found[0]))[1]


def check_scheduling() -> MachineFinding:
    """Whether a supervisor may ask to be woken first."""
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except PermissionError:
        fix = "Wake-ups may come a tick late. Allow it: 'rtprio 10' for this user in /etc/security/limits.conf."
        return MachineFinding("scheduling", Grade.WEAK, "real-time priority is not granted", fix)
    os.sched_setscheduler(0, policy, parameters)
    return MachineFinding("scheduling", Grade.FINE, "real-time priority is granted")


def check_ports() -> MachineFinding:
    """Whether a server can listen on this machine, as policy servers do."""
    try:
        with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()[:2], 2.0):
            return MachineFinding("ports", Grade.FINE, "a local server can be reached")
    except OSError as error:
        return MachineFinding("ports", Grade.WEAK, str(error), "Policy servers need the loopback: ip link set lo up.")
