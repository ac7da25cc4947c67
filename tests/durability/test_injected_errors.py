"""The n-th call fails, for n = 1, 2, 3 ... until a whole workload never comes that far."""

import errno
import os
import shutil

import pytest

from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.journal import Journal
from phyagentos.testing import ManualClock

from . import second_reader
from .interception import Calls, intercept
from .workloads import LANE, NOON_S, Bench, identify, make_submit

pytestmark = pytest.mark.slow

COMMANDS = ("submit", "batch", "claim", "checkpoint", "rotate", "claim", "archive", "defer", "submit")
KINDS = {"ENOSPC": errno.ENOSPC, "EIO": errno.EIO, "EINTR": errno.EINTR, "EDQUOT": errno.EDQUOT}
SYNCS = {"fsync", "fdatasync"}
FULL = {errno.ENOSPC, errno.EDQUOT}


class NthCall(Calls):
    """Lets the n-th call that changes the disk fail; half of a write has happened by then."""

    def __init__(self, root, nth, number):
        super().__init__(root)
        self.nth, self.number, self.seen, self.failed = nth, number, 0, ""

    def by_descriptor(self, name, real, path, fd, *args):
        if self._is_it(name):
            if name == "write":
                real(fd, bytes(args[0])[: len(args[0]) // 2])
            raise OSError(self.number, os.strerror(self.number))
        return real(fd, *args)

    def by_path(self, name, real, *paths):
        if self._is_it(name):
            raise OSError(self.number, os.strerror(self.number))
        return real(*paths)

    def _is_it(self, name):
        if name == "pread":
            return False
        if name in SYNCS and self.number in FULL:  # a full disk is told by the write
            return False
        self.seen += 1
        if self.seen == self.nth:
            self.failed = name
        return self.seen == self.nth


class ShortWrite(NthCall):
    """Only the n-th write is taken in part, one byte of it."""

    def by_descriptor(self, name, real, path, fd, *args):
        if name == "write" and self._is_it(name):
            return real(fd, bytes(args[0])[:1])
        return real(fd, *args)

    def by_path(self, name, real, *paths):
        return real(*paths)


class NthRead(NthCall):
    """The n-th piece of a file cannot be read."""

    def by_descriptor(self, name, real, path, fd, *args):
        if name == "pread":
            self.seen += 1
            if self.seen == self.nth:
                self.failed = name
                raise OSError(errno.EIO, os.strerror(errno.EIO))
        return real(fd, *args)

    def by_path(self, name, real, *paths):
        return real(*paths)


class FullFrom(NthCall):
    """Every write from the n-th on finds the disk full, until there is room again."""

    has_room = False

    def by_descriptor(self, name, real, path, fd, *args):
        if name in {"write", "pwrite"} and not self.has_room:
            self.seen += 1
            if self.seen >= self.nth:
                self.failed = name
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(fd, *args)

    def by_path(self, name, real, *paths):
        return real(*paths)


def prepare(root):
    """A lane in which a writer has died in the middle of a record."""
    first = Bench(root, durable=False)
    first.submit()
    first.close()
    (path,) = (root / "sessions" / LANE).glob("*.md")
    path.write_bytes(path.read_bytes() + b"<!-- phy1 0000000002 000900 00000000 -->\n- {")
    return first.told


def attempt(bench, name):
    """Run one command; the code of the error that ended it."""
    try:
        bench.run(name)
    except ExecutionError as error:
        return error.code
    return ""


def read_all(root):
    journal = Journal(root, side=Side.RUNTIME, by="late", partition=LANE, clock=ManualClock(NOON_S), durable=False)
    journal.commit([])
    found = [identify(record) for record in journal.read_new()]
    journal.close()
    assert found == [second_reader.identify(record) for record in second_reader.read_lane(root, LANE)]
    return found


def run_until_out_of_reach(memory, make, check):
    """Workloads with a fault at call 1, 2, 3 ...; how often each call failed, commits that failed, records told."""
    nth, failed, errors, acknowledged, lost = 0, {}, 0, 0, 0
    while True:
        nth += 1
        root = memory / "w"
        told = prepare(root)
        bench = Bench(root)
        bench._named = 1
        with intercept(make(root, nth)) as calls:
            codes = [check(bench, calls, name) for name in COMMANDS]
        bench.close()
        told |= bench.told
        found = set(read_all(root))
        lost += len(set(told.values()) - found)
        acknowledged += len(told)
        errors += sum(map(bool, codes))
        shutil.rmtree(root)
        if not calls.failed:
            return {"faults": nth - 1, "errors": errors, "acknowledged": acknowledged, "lost": lost} | failed
        failed[calls.failed] = failed.get(calls.failed, 0) + 1


def check_failure(bench, calls, name):
    """A fault is told by its code; after a failed sync the process is at an end, after anything else it goes on."""
    had_failed = bool(calls.failed)
    code = attempt(bench, name)
    assert not (code and had_failed), f"{name}: {code}, though nothing failed any more"
    if calls.failed in SYNCS and not had_failed:
        assert code == "JOURNAL_NOT_DURABLE", f"{name}: a sync failed, and the process went on"
    if code == "JOURNAL_NOT_DURABLE":
        assert calls.failed in SYNCS
        if journal := bench.find(bench.last_side):
            for _ in range(2):
                with pytest.raises(ExecutionError, match=r"JOURNAL_NOT_DURABLE: .*end this process"):
                    journal.commit([make_submit("late")])
            bench.close(bench.last_side)
    elif code:
        assert (code, calls.failed in SYNCS) == ("WRITE_FAILED", False)
    return code


def test_the_nth_read_fails(memory, figures):
    def check(bench, calls, name):
        before = dict(bench.told)
        code = attempt(bench, name)
        assert code in {"", "UNREADABLE_FILE"}
        if code:
            assert calls.failed
            assert attempt(bench, name) == ""  # it was only once
            assert len(bench.told) >= len(before)
        return code

    told = run_until_out_of_reach(memory, lambda root, nth: NthRead(root, nth, errno.EIO), check)
    figures(**told)
    assert told["lost"] == 0
    assert told["errors"] > 10


@pytest.mark.parametrize("kind", KINDS)
def test_the_nth_call_fails(memory, figures, kind):
    told = run_until_out_of_reach(memory, lambda root, nth: NthCall(root, nth, KINDS[kind]), check_failure)
    figures(**told)
    assert told["lost"] == 0
    assert told["faults"] > 10


def test_the_nth_write_is_taken_in_part(memory, figures):
    told = run_until_out_of_reach(memory, lambda root, nth: ShortWrite(root, nth, 0), check_failure)
    figures(**told)
    assert (told["lost"], told["errors"]) == (0, 0)


def test_the_disk_is_full_from_the_nth_write_on_until_there_is_room(memory, figures):
    def check(bench, calls, name):
        code = attempt(bench, name)
        if name in {"checkpoint", "archive"} and not code:  # what is left for the next time says nothing
            return code
        assert code == ("WRITE_FAILED" if calls.failed and not calls.has_room else "")
        if code:
            before = dict(bench.told)
            assert attempt(bench, name) == code
            assert bench.told == before
            calls.has_room = True
            assert attempt(bench, name) == ""
            assert len(bench.told) > len(before)
        return code

    told = run_until_out_of_reach(memory, lambda root, nth: FullFrom(root, nth, 0), check)
    figures(**told)
    assert told["lost"] == 0
    assert told["errors"] > 5
