"""RUNTIME_SIGNAL.md and the health of a target never claim a life that has ended."""

import os
import subprocess
import sys

import pytest

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.registries import publish_health, read_target_registry
from phyagentos.protocol.capabilities.targets import TARGETS, Health, TargetHealth
from phyagentos.protocol.documents.document import read_document
from phyagentos.protocol.sessions.heartbeats import Heartbeat, is_process_alive, write_heartbeat
from phyagentos.protocol.sessions.runtime_signal import RUNTIME_SIGNAL, RequestState, RuntimeState
from phyagentos.protocol.sessions.stop_signals import Signal, drop_signal, take_signals
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.runtime_signal import PERIOD_S, RENEWAL_S, SILENCE_S, RuntimeSignal
from phyagentos.testing import ManualClock


@pytest.fixture
def clock():
    return ManualClock(1_000_000.0)


@pytest.fixture
def workspace(tmp_path, root):
    return Workspace.create(tmp_path / "w", Library.open(root))


@pytest.fixture
def signal(workspace, clock):
    return RuntimeSignal(workspace, clock)


@pytest.fixture
def beat(workspace):
    def write(**facts):
        write_heartbeat(workspace.heartbeats, Heartbeat(**({"target": "panda", "pid": os.getpid()} | facts)))

    return write


def read_signs(workspace):
    return read_document(workspace.runtime_signal.read_text(), RUNTIME_SIGNAL).blocks["Signs"]


def read_health(workspace):
    return read_document(workspace.target_registry.read_text(), TARGETS).blocks["panda"].health


@pytest.fixture
def dead_pid():
    done = subprocess.Popen([sys.executable, "-c", ""])
    done.wait()
    return done.pid


def test_a_worker_is_ready_while_its_process_lives(workspace, clock, signal, beat):
    beat(phase="executing", session="s", tick=7)
    signal.refresh()

    assert read_signs(workspace).workers["panda"].health is Health.READY
    assert read_health(workspace).state is Health.READY
    assert "| panda | ready | executing | s |" in workspace.runtime_signal.read_text()
    assert "| panda | ready since 1970-01-12" in workspace.target_registry.read_text()


def test_a_worker_whose_process_ended_is_lost(workspace, clock, signal, beat, dead_pid):
    beat(phase="executing", session="s", pid=dead_pid)
    signal.refresh()

    assert read_health(workspace) == TargetHealth(state=Health.LOST, since=clock.wall_iso(), session="s")
    assert "| panda | lost (s) since" in workspace.target_registry.read_text()


def test_a_process_that_nobody_collected_is_not_alive():
    child = subprocess.Popen([sys.executable, "-c", ""])
    os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOWAIT)

    assert not is_process_alive(child.pid)
    assert is_process_alive(os.getpid())
    child.wait()


EXECUTING = {"phase": "executing", "session": "s", "sequence": 1}


@pytest.mark.parametrize(
    ("beats", "health"),
    [
        pytest.param([EXECUTING, (SILENCE_S + 0.1, {})], Health.SILENT, id="it holds a session and says nothing new"),
        pytest.param(
            [EXECUTING, (SILENCE_S + 0.1, {}), (PERIOD_S, EXECUTING | {"sequence": 2})],
            Health.READY,
            id="it speaks again",
        ),
        pytest.param([{}, (10 * SILENCE_S, {})], Health.READY, id="an idle worker need not speak"),
    ],
)
def test_a_worker_is_silent_only_while_it_holds_a_session(workspace, clock, signal, beat, beats, health):
    first, *later = beats
    beat(**first)
    signal.refresh()
    for after_s, facts in later:
        clock.advance(after_s)
        if facts:
            beat(**facts)
        signal.refresh()
    assert read_health(workspace).state is health


def test_after_the_end_nothing_claims_to_live(workspace, clock, signal, beat):
    beat()
    signal.refresh()
    signal.close()
    signs = read_signs(workspace)

    assert (signs.runtime, signs.workers["panda"].health) == (RuntimeState.ENDED, Health.STOPPED)
    assert read_health(workspace).state is Health.STOPPED
    assert "**The runtime ended**" in workspace.runtime_signal.read_text()
    assert "is running" not in workspace.runtime_signal.read_text()


def test_a_beat_of_an_earlier_runtime_is_not_a_life(workspace, clock, beat):
    beat()
    signal = RuntimeSignal(workspace, clock)
    signal.refresh()
    assert read_health(workspace).state is Health.STOPPED

    beat(sequence=1)
    clock.advance(PERIOD_S)
    signal.refresh()
    assert read_health(workspace).state is Health.READY


def test_a_health_that_stays_keeps_its_time(workspace, clock, beat):
    beat()
    RuntimeSignal(workspace, clock).close()
    since = read_health(workspace).since
    clock.advance(3600)
    RuntimeSignal(workspace, clock).refresh()

    assert read_health(workspace) == TargetHealth(state=Health.STOPPED, since=since)


def test_the_document_is_renewed_while_nothing_happens(workspace, clock, signal, beat):
    beat()
    signal.refresh()
    begin = read_signs(workspace).at
    clock.advance(RENEWAL_S / 2)
    signal.refresh()
    assert read_signs(workspace).at == begin

    clock.advance(RENEWAL_S / 2)
    signal.refresh()
    assert read_signs(workspace).at == clock.wall_iso() > begin


def test_requests_are_shown_with_what_became_of_them(workspace, clock, signal):
    drop_signal(workspace.signals, Signal(kind="cancel", session="a", by="ann", reason="enough"), clock)
    signal.refresh()
    take_signals(workspace.signals)
    clock.advance(1.0)
    drop_signal(workspace.signals, Signal(kind="estop", by="ann"), clock)
    signal.refresh()
    requests = read_signs(workspace).requests

    assert [(each.state, each.kind, each.session, each.by) for each in requests] == [
        (RequestState.TAKEN, "cancel", "a", "ann"),
        (RequestState.WAITING, "estop", "*", "ann"),
    ]
    assert "| taken | cancel | a | ann | enough |" in workspace.runtime_signal.read_text()


REQUEST = """
## Request

```yaml
kind: cancel
session: "*"
by: ann
```
"""


@pytest.fixture
def edited(workspace, clock, signal):
    """A document that is rendered and can be edited: gives what rendering goes on after, for some seconds."""
    signal.refresh()

    def go_on(seconds=5.0):
        for _ in range(int(seconds / PERIOD_S)):
            clock.advance(PERIOD_S)
            signal.refresh()
        return [path.read_text() for path in sorted(workspace.signals.iterdir())]

    yield go_on
    signal.close()


def test_a_request_that_is_written_into_the_document_becomes_a_signal(workspace, edited):
    path = workspace.runtime_signal
    path.write_text(path.read_text() + REQUEST)

    assert edited() == ['kind: cancel\nsession: "*"\nby: ann\n']
    assert "\n## Request" not in path.read_text()
    assert [(each.kind, each.by) for each in take_signals(workspace.signals)] == [("cancel", "ann")]
    assert edited() == []
    assert "| taken | cancel | * | ann |" in path.read_text()


def test_an_editor_that_replaces_the_document_is_heard_too(workspace, edited, tmp_path):
    copy = tmp_path / "copy.md"
    copy.write_text(workspace.runtime_signal.read_text().replace("## Signs", f"{REQUEST}\n## Signs"))
    copy.replace(workspace.runtime_signal)

    assert len(edited()) == 1


def test_a_request_that_nobody_can_read_is_rejected_with_the_reason(workspace, edited):
    path = workspace.runtime_signal
    path.write_text(path.read_text() + "\n## Request\n\nplease stop\n")

    assert edited() == ["please stop\n"]
    past_s = (workspace.runtime_signal.stat().st_mtime - 10,) * 2
    os.utime(next(workspace.signals.iterdir()), past_s)
    assert take_signals(workspace.signals) == []
    (reason,) = (workspace.root / "signals" / "rejected").glob("*.reason.txt")
    assert "Nothing was done" in reason.read_text()


def test_a_request_that_was_written_at_the_end_is_not_lost(workspace, clock, signal):
    signal.refresh()
    workspace.runtime_signal.write_text(workspace.runtime_signal.read_text() + REQUEST)
    signal.close()

    assert len(list(workspace.signals.iterdir())) == 1
    assert read_signs(workspace).runtime is RuntimeState.ENDED


def test_a_change_of_health_keeps_what_a_person_changed_in_a_block(workspace):
    path = workspace.target_registry
    path.write_text(path.read_text().replace("max_width_m: 0.08", "max_width_m: 0.07"))
    assert publish_health(path, {"panda": TargetHealth(state=Health.READY)})

    assert read_target_registry(path)["panda"].gripper.max_width_m == 0.07
    assert read_health(workspace).state is Health.READY


def test_a_registry_that_somebody_is_editing_is_left_alone(workspace):
    path = workspace.target_registry
    path.write_text(path.read_text()[:-40])
    before = path.read_text()

    assert not publish_health(path, {"panda": TargetHealth(state=Health.READY)})
    assert path.read_text() == before
