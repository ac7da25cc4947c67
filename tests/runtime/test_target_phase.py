"""The statechart of a target's phases, driven at random, and the log of its changes."""

import json
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from phyagentos.runtime.supervision.target_phase import (
    FAILURES,
    PHASE_TRANSITIONS,
    IllegalPhase,
    Phase,
    PhaseLog,
    fire_phase,
)
from phyagentos.testing import ManualClock

TRIGGERS = sorted({row.trigger for row in PHASE_TRANSITIONS})


@dataclass
class Target:
    """What the conditions look at."""

    state: str = "starting"
    failures: int = 0
    attempts: int = FAILURES
    lost: object | None = None

    def holds(self, condition: str) -> bool:
        return {
            "": True,
            "nothing lost": self.lost is None,
            "a session lost": self.lost is not None,
            "attempts left": self.failures < FAILURES,
            "no attempts left": self.failures >= FAILURES,
        }[condition]


EVENTS = st.lists(st.tuples(st.sampled_from(TRIGGERS), st.integers(0, FAILURES), st.booleans()), max_size=40)


@pytest.mark.slow
@given(EVENTS)
def test_no_sequence_of_events_leaves_the_table(events):
    target = Target()
    for trigger, target.failures, is_lost in events:
        target.lost = "a session" if is_lost else None
        before = target.state
        rows = [row for row in PHASE_TRANSITIONS if row.trigger == trigger and before in row.sources]
        dests = [row.dest for row in rows if target.holds(row.when)]
        if dests:
            fire_phase("panda", target, trigger)
            assert [target.state] == dests
        else:
            with pytest.raises(IllegalPhase, match=f"target panda: '{trigger}' in phase '{before}'. Possible: "):
                fire_phase("panda", target, trigger)
            assert target.state == before


def test_every_phase_can_be_reached_and_every_other_than_broken_can_be_left():
    assert {row.dest for row in PHASE_TRANSITIONS} == set(Phase)
    assert {source for row in PHASE_TRANSITIONS for source in row.sources} == set(Phase) - {Phase.BROKEN}


def test_each_change_is_a_line_and_a_folder_that_is_gone_ends_no_supervision(tmp_path):
    log = PhaseLog(tmp_path, "panda", ManualClock(0.0))
    log.note("ready", "starting", "idle", "")
    log.note("check", "idle", "checking", "g.a")
    PhaseLog(tmp_path / "gone", "panda", ManualClock(0.0)).note("ready", "starting", "idle", "")

    lines = [json.loads(line) for line in (tmp_path / "events-panda.jsonl").read_text().splitlines()]
    assert [(line["ev"], line["from"], line["to"], line.get("session")) for line in lines] == [
        ("ready", "starting", "idle", None),
        ("check", "idle", "checking", "g.a"),
    ]
