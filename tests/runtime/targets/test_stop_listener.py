"""Stop requests reach the target itself: by a latch, by a file in signals/new, over a restart."""

import pytest

from phyagentos.clock import SystemClock
from phyagentos.protocol.estop import Latch, latch, read_latch, reset
from phyagentos.protocol.store.mailbox import Signal, drop_signal, take_signals
from phyagentos.runtime.targets.stop_listener import StopListener


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


def test_a_file_that_any_tool_drops_is_latched_before_it_is_told(tmp_path, listen):
    listener = listen()
    drop_signal(tmp_path, Signal(kind="estop", by="a button", reason="a hand in the cell"), SystemClock())

    assert listener.is_latched()
    assert read_latch(tmp_path).by == "a button"


def test_a_request_that_the_watchdog_took_first_is_heard_all_the_same(tmp_path, listen):
    listener = listen()
    drop_signal(tmp_path, Signal(kind="estop", by="a button"), SystemClock())
    take_signals(tmp_path)

    assert listener.is_latched()


def test_other_requests_stop_nothing(tmp_path, listen):
    listener = listen()
    drop_signal(tmp_path, Signal(kind="cancel"), SystemClock())

    assert not listener.is_latched()


def test_a_latch_outlives_whoever_heard_it(tmp_path, listen):
    latch(tmp_path, Latch(by="me"))

    assert listen().is_latched()
