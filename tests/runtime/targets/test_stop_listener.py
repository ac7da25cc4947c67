"""Stop requests reach the target itself: by a latch, by a file in signals/new, over a restart."""

import errno
import os
from pathlib import Path

import pytest

from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.estop import RESERVE, Latch, is_latched, latch, read_latch, reset
from phyagentos.protocol.sessions.stop_signals import Signal, drop_signal, take_signals
from phyagentos.runtime.targets.stop_listener import LOOK_MAX, StopListener
from phyagentos.testing import ManualClock


@pytest.fixture
def listen(tmp_path):
    listeners = []

    def make():
        listeners.append(StopListener(tmp_path, SystemClock()))
        return listeners[-1]

    yield make
    for listener in listeners:
        listener.close()


def test_a_latch_is_heard_and_so_is_its_reset(tmp_path, listen):
    listener = listen()
    assert not listener.is_latched()
    latch(tmp_path, Latch(by="me"))
    assert listener.is_latched()
    reset(tmp_path, "all is well", SystemClock())
    assert not listener.is_latched()


def test_a_file_that_any_tool_drops_is_in_force_at_once_and_on_the_disk_when_it_is_kept(tmp_path, listen, monkeypatch):
    listener = listen()
    synced = []
    monkeypatch.setattr(os, "fsync", synced.append)
    drop_signal(tmp_path, Signal(kind="estop", by="a button", reason="a hand in the cell"), SystemClock())

    assert listener.is_latched()
    assert synced == []  # the arm comes to rest first
    listener.keep()
    assert len(synced) == 2  # the file, and its folder
    assert read_latch(tmp_path).by == "a button"
    assert listener.is_latched()


@pytest.mark.parametrize("reason", [r"fire \ud83d\udd25", r"half of \ud83d", "too close\x7f", "Gef\xe4\xdf"])
def test_a_stop_is_kept_whatever_its_reason_holds(tmp_path, listen, reason):
    listener = listen()
    (tmp_path / "new" / "stop.json").write_bytes(f'{{"kind": "estop", "reason": "{reason}"}}'.encode("latin-1"))

    assert listener.is_latched()
    listener.keep()
    assert read_latch(tmp_path).reason[:3] == reason[:3]


@pytest.mark.parametrize("has_reserve", [True, False])
def test_a_full_disk_holds_up_no_stop_and_is_asked_again_until_it_takes_it(tmp_path, monkeypatch, has_reserve):
    clock = ManualClock()
    listener = StopListener(tmp_path, clock)
    drop_signal(tmp_path, Signal(kind="estop", by="a button"), SystemClock())
    if not has_reserve:
        (tmp_path / RESERVE).unlink()
    with monkeypatch.context() as full:
        full.setattr(Path, "open", refuse)
        assert listener.is_latched()
        listener.keep()
        assert listener.is_latched()
        assert is_latched(tmp_path) == has_reserve
    clock.advance(1.0)
    listener.keep()

    assert is_latched(tmp_path)
    reset(tmp_path, "all is well", SystemClock())
    assert not listener.is_latched()
    listener.close()


OPEN = Path.open


def refuse(path, mode="r", *rest, **options):
    if mode.startswith("r"):
        return OPEN(path, mode, *rest, **options)
    raise OSError(errno.ENOSPC, "No space left on device", str(path))


@pytest.mark.parametrize(("kind", "stops"), [("estop", True), ("cancel", False)])
def test_only_an_emergency_stop_stops_and_also_where_the_watchdog_took_it_first(tmp_path, listen, kind, stops):
    listener = listen()
    drop_signal(tmp_path, Signal(kind=kind, by="a button"), SystemClock())
    take_signals(tmp_path)

    assert listener.is_latched() == stops


def test_a_latch_outlives_whoever_heard_it(tmp_path, listen):
    latch(tmp_path, Latch(by="me"))

    assert listen().is_latched()


@pytest.mark.slow
def test_a_stop_beside_ten_thousand_files_is_heard_at_the_next_look_which_reads_a_bounded_number(
    tmp_path, listen, monkeypatch
):
    listener = listen()
    for number in range(10_000):
        (tmp_path / "new" / f"{number}").write_text("kind: [")
    drop_signal(tmp_path, Signal(kind="estop", by="a button"), SystemClock())
    opened, really_open = [], os.open
    monkeypatch.setattr(os, "open", lambda *args: opened.append(args) or really_open(*args))

    assert listener.is_latched()
    assert len(opened) <= LOOK_MAX


def test_what_a_look_leaves_is_read_by_the_next_ones(tmp_path, listen):
    listener = listen()
    drop_signal(tmp_path, Signal(kind="estop", by="a button"), SystemClock())
    for number in range(3 * LOOK_MAX):
        (tmp_path / "new" / f"{number}").write_text("kind: [")

    assert [listener.is_latched() for _ in range(4)] == [False, False, False, True]


@pytest.mark.slow
def test_more_events_than_the_kernel_keeps_lose_no_stop(tmp_path, listen):
    listener = listen()
    drop_signal(tmp_path, Signal(kind="estop", by="a button"), SystemClock())
    others = [tmp_path / "new" / f"other.{number}" for number in range(2)]
    for other in others:
        other.write_text("kind: [")
    for number in range(18_000):  # each time it is closed is an event, and equal ones in a row would be one
        os.close(os.open(others[number % 2], os.O_WRONLY))

    assert listener.is_latched()  # beside two other files


@pytest.mark.parametrize("target", ["estop.json", "nowhere", "/proc/kmsg"])
def test_a_link_in_the_place_of_the_latch_is_a_latch(tmp_path, listen, target):
    (tmp_path / "estop.json").symlink_to(target)

    assert listen().is_latched()
    assert "cannot be read" in read_latch(tmp_path).reason
    reset(tmp_path, "it was a prank", SystemClock())
    assert not is_latched(tmp_path)
