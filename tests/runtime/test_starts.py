"""One session follows another, and nothing is commanded before its start is on the disk."""

import pytest

from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.estop import Latch, latch
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Ended
from phyagentos.runtime.supervision.watchdog import Watchdog
from phyagentos.runtime.worker.orders import Check, Renew, Run
from phyagentos.store.journal import Entry, Journal
from phyagentos.store.segments import SystemIO

from .test_watchdog import ScriptedWorker, finish, make_session, stand  # noqa: F401 - a fixture


def tell(worker) -> list[tuple[str, str]]:
    """The orders that a worker was given."""
    return [(type(order).__name__, order.session.id) for order in worker.orders if isinstance(order, Check | Run)]


def during(id: str, act):
    """A run in which something happens elsewhere while one session runs; it ends when that has happened."""

    def run(order: Run):
        if order.session.id == id:
            act()
        return finish(Ended.COMPLETED)(order)

    return run


def record_as_operator(stand, *entries: Entry) -> None:  # noqa: F811
    journal = Journal(stand.workspace.root, side=Side.OPERATOR, by="hand", clock=SystemClock())
    journal.commit(entries)
    journal.close()


def test_each_session_is_checked_once_in_turn_and_a_more_urgent_one_that_comes_meanwhile_is_next(stand):  # noqa: F811
    urgent = during("g.a", lambda: stand.submit(make_session("g.c", priority=5)))
    stand.submit(make_session("g.a"), make_session("g.b"))
    stand.watch(worker := ScriptedWorker(on_run=urgent))

    stand.wait_for("g.b", "awaiting_verification")

    assert tell(worker) == [(kind, f"g.{name}") for name in "acb" for kind in ("Check", "Run")]
    for name in "acb":
        assert stand.events(f"g.{name}") == ["submit", "claim", "check", "start", "halt", "finish"]


def test_a_contract_that_was_amended_while_it_waited_runs_as_amended(stand):  # noqa: F811
    def amend() -> None:
        record_as_operator(stand, Entry("g.b", "amend", {"limits": {"timeout_s": 7.0}}))

    stand.submit(make_session("g.a"), make_session("g.b"))
    stand.watch(worker := ScriptedWorker(on_run=during("g.a", amend)))

    stand.wait_for("g.b", "awaiting_verification")

    checked = [order.session.limits.timeout_s for order in worker.orders if isinstance(order, Check)]
    assert checked[-1] == 7.0
    assert worker.orders[-1].session.limits.timeout_s == 7.0


def test_a_stop_that_is_latched_meanwhile_leaves_the_next_session_waiting(stand):  # noqa: F811
    def stop() -> None:
        latch(stand.workspace.signals.parent, Latch(by="test", reason="enough"))

    stand.submit(make_session("g.a"), make_session("g.b"))
    stand.watch(worker := ScriptedWorker(on_run=during("g.a", stop)))

    stand.wait_for("g.a", "awaiting_verification")
    stand.watchdog.stop()
    stand.thread.join(20.0)

    assert stand.poll("g.b") == "pending"
    assert ("Run", "g.b") not in tell(worker)


class Course:
    """What happened, in order, as a worker and a disk see it."""

    def __init__(self) -> None:
        self.events: list[str] = []


class WatchedDisk(SystemIO):
    """Notes what is written and what is waited for."""

    def __init__(self, course: Course) -> None:
        self._course = course

    def write(self, fd, data):
        self._course.events += [ev for ev in ("start", "finish") if b'"ev":"%b"' % ev.encode() in bytes(data)]
        return super().write(fd, data)

    def fdatasync(self, fd):
        super().fdatasync(fd)
        self._course.events.append("on the disk")


class Observer(ScriptedWorker):
    """Notes what it is asked to do."""

    def __init__(self, course: Course, **answers) -> None:
        super().__init__(**answers)
        self._course = course

    def send(self, order) -> None:
        self._course.events += [type(order).__name__] if isinstance(order, Run | Renew) else []
        super().send(order)


def watch_disk(stand, worker, disk):  # noqa: F811
    """As `Stand.watch`, with a disk of its own."""
    clock = SystemClock()
    journal = Journal(stand.workspace.root, side=Side.RUNTIME, by="watchdog", clock=clock, file_io=disk)
    hire = {"panda": worker}.get
    return Watchdog(workspace=stand.workspace, journal=journal, hire=hire, clock=clock, publish=lambda: None)


def test_a_session_has_its_first_lease_only_when_its_start_is_on_the_disk(stand):  # noqa: F811
    course = Course()
    stand.submit(*(make_session(f"g.{number}") for number in range(5)))
    worker = Observer(course)
    watchdog = watch_disk(stand, worker, WatchedDisk(course))
    worker._on_run = stop_after(5, watchdog.stop)
    watchdog.run()

    told = [event for event in course.events if event != "finish"]
    first = told.index("start")
    assert told[first:] == ["start", "Run", "on the disk", "Renew"] * 5


def test_a_disk_that_does_not_confirm_a_start_lets_nothing_move(stand):  # noqa: F811
    class Failing(WatchedDisk):
        def fdatasync(self, fd):
            if "start" in self._course.events:
                raise OSError(5, "Input/output error")
            super().fdatasync(fd)

    course = Course()
    stand.submit(make_session("g.a"))
    watchdog = watch_disk(stand, Observer(course), Failing(course))

    with pytest.raises(Exception, match="JOURNAL_NOT_DURABLE"):
        watchdog.run()

    assert course.events[-2:] == ["start", "Run"]


def stop_after(runs: int, stop):
    left = [runs]

    def run(order: Run):
        left[0] -= 1
        if not left[0]:
            stop()
        return finish(Ended.COMPLETED)(order)

    return run
