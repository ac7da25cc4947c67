"""A worker that beats is not yet a worker that works."""

import msgspec
import pytest

from phyagentos.protocol.sessions.heartbeats import Heartbeat, find_heartbeat, write_heartbeat
from phyagentos.protocol.sessions.session import Limits
from phyagentos.runtime.supervision.limits import OBSERVE_S, FaultKind, HeartbeatMonitor
from phyagentos.testing import ManualClock

LIMITS = Limits(heartbeat_s=3.0, stall_s=5.0, think_s=12.0)
PID = 41
PERIOD_S = 0.5


class Heart:
    """A worker's heartbeats, and the monitor that reads them."""

    def __init__(self, folder) -> None:
        self.folder, self.clock = folder, ManualClock()
        self.now = Heartbeat(target="arm", pid=PID, session="s", epoch=1, phase="executing")
        self.monitor = HeartbeatMonitor(folder, "arm", self.clock)

    def beat(self, **changes):
        """Half a second passes, something is said, and the watchdog looks."""
        self.clock.advance(PERIOD_S)
        changes = {"sequence": self.now.sequence + 1, **changes}
        self.now = msgspec.structs.replace(self.now, **changes)
        write_heartbeat(self.folder, self.now)
        return self.look()

    def look(self):
        return self.monitor.find_fault(LIMITS, PID)

    def beat_until_trouble(self, changes=lambda _: {}, at_most=200):
        for count in range(at_most):
            if (fault := self.beat(**changes(count))) is not None:
                return fault, count * PERIOD_S
        return None, at_most * PERIOD_S


@pytest.fixture
def heart(tmp_path):
    return Heart(tmp_path)


@pytest.mark.parametrize(
    "says",
    [
        lambda count: {"tick": count},
        lambda count: {"sim_time_s": 0.1 * count},
        lambda _: {"phase": "paused"},
    ],
    ids=["commands", "its simulated time goes on", "pauses"],
)
def test_one_that_beats_and_acts_or_rests_is_left_alone(heart, says):
    assert heart.beat_until_trouble(says)[0] is None


@pytest.mark.parametrize(
    ("said", "message", "limit_s"),
    [
        ({"tick": 7, "sim_time_s": 1.0}, "it acts, and no control period has passed for 5.0 s", LIMITS.stall_s),
        ({"phase": "thinking"}, "waits for a planner", LIMITS.think_s),
        ({"phase": "looking"}, "looks", OBSERVE_S),
    ],
)
def test_one_that_beats_without_progress_is_stalled_after_the_limit_of_what_it_does(heart, said, message, limit_s):
    heart.beat(**said)

    fault, after_s = heart.beat_until_trouble()

    assert (fault.kind, message in fault.message) == (FaultKind.STALLED, True)
    assert limit_s <= after_s <= limit_s + 2 * PERIOD_S


def test_going_to_and_fro_between_thinking_and_acting_hides_no_stall(heart):
    phases = ("thinking", "executing")

    fault, _ = heart.beat_until_trouble(lambda count: {"phase": phases[count % 2], "leaf": str(count)})

    assert fault.kind is FaultKind.STALLED


def test_acting_after_a_long_thought_is_no_stall(heart):
    heart.beat(phase="thinking")
    for _ in range(20):
        assert heart.beat() is None
    assert heart.beat(phase="executing") is None
    assert heart.beat(tick=1) is None


def test_one_that_says_nothing_new_is_silent(heart):
    heart.beat(tick=1)
    heart.clock.advance(LIMITS.heartbeat_s + 0.1)

    assert heart.look().kind is FaultKind.SILENT


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ({"sequence": 8, "tick": 6}, "beat 8 follows beat 9"),
        ({"tick": 4}, ""),
        ({"sim_time_s": 0.5}, ""),
        ({"pid": PID + 1, "tick": 6}, f"process {PID + 1} beats for arm, whose worker is process {PID}"),
    ],
)
def test_what_runs_backwards_and_two_beaters_for_one_target_are_inconsistent(heart, said, message):
    heart.beat(sequence=9, tick=5, sim_time_s=1.0)

    fault = heart.beat(**said)

    assert (fault.kind, fault.message) == (FaultKind.INCONSISTENT, message or fault.message)


def test_the_next_session_begins_to_count_anew(heart):
    heart.beat(tick=500, sim_time_s=9.0)
    heart.monitor.restart()

    assert heart.beat(session="t", tick=0) is None
    assert heart.beat(session="t", tick=1) is None


def test_a_second_beater_that_came_first_is_found_too(heart):
    assert heart.beat(pid=PID + 1) is None  # it may be the last word of an earlier worker

    assert heart.beat(pid=PID + 1).kind is FaultKind.INCONSISTENT


def test_the_last_word_of_an_earlier_worker_is_no_sign_of_life(heart):
    write_heartbeat(heart.folder, msgspec.structs.replace(heart.now, pid=PID - 1, sequence=900))
    heart.monitor.restart()
    for _ in range(5):
        heart.clock.advance(PERIOD_S)
        assert heart.look() is None
    heart.clock.advance(PERIOD_S + 0.1)

    assert heart.look().kind is FaultKind.SILENT


def test_a_watchdog_that_was_stopped_itself_holds_that_against_nobody(heart):
    heart.beat(tick=1)
    heart.clock.advance(60.0)

    assert heart.beat() is None
    assert heart.beat() is None


def test_a_deleted_folder_of_heartbeats_comes_back(tmp_path):
    beat = Heartbeat(target="arm", pid=1)
    for _ in range(2):
        write_heartbeat(tmp_path / "heartbeats", beat)
    assert find_heartbeat(tmp_path / "heartbeats", "arm") == beat
