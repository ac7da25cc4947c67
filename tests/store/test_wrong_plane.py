"""A record from the wrong plane is refused by the journal, whatever it says and wherever the session stands."""

import pytest

from phyagentos.protocol.sessions.lifecycle import SESSION_TRANSITIONS, IllegalTransition, Side
from phyagentos.store.admission import Entry, GoalEvent, IllegalEvent

_LIFE = (
    *((trigger, Side.RUNTIME) for trigger in ("claim", "check", "start", "halt", "finish")),
    ("verify", Side.AGENT),
)
_STATES = ("pending", "claimed", "preflight", "running", "halting", "awaiting_verification", "verifying")
PATHS = {state: _LIFE[:number] for number, state in enumerate(_STATES)}
PATHS |= {
    "cancelling": (*PATHS["running"], ("request_cancel", Side.OPERATOR)),
    "outcome_unknown": (*PATHS["running"], ("lose", Side.RUNTIME)),
}
PATHS |= {
    state: (*PATHS["verifying"], (trigger, Side.AGENT))
    for state, trigger in (
        ("succeeded", "accept"), ("failed", "refuse"), ("replanned", "replan"), ("unverified", "skip"),
    )
}  # fmt: skip
BODIES = {"review": {"attempt": {"verdict": "success", "criteria": [], "is_review": True}}}
ROWS = [
    (source.value, row.trigger, side, row) for row in SESSION_TRANSITIONS for source in row.sources for side in Side
]
AMENDMENTS = ("amendment_asked", "goal_amended", "amendment_refused")
GOAL_EVENTS = ("goal_compiled", "budget_spent", "goal_verdict", "goal_cancelled", *AMENDMENTS)
OF_OPERATOR = ("goal_submitted", "goal_cancelled", "amendment_asked")


def read_bytes(journal) -> bytes:
    return b"".join(path.read_bytes() for path in sorted(journal.folder.glob("*.md")))


@pytest.mark.parametrize(("state", "trigger", "side", "row"), ROWS, ids=lambda value: getattr(value, "value", value))
def test_a_trigger_is_recorded_for_its_own_sides_and_refused_to_the_others(
    open_journal, submit, state, trigger, side, row
):
    journals = {each: open_journal(each, f"the {each}") for each in Side}
    journals[Side.AGENT].commit([submit("s")])
    for before, by in PATHS[state]:
        journals[by].commit([Entry("s", before)])
    stood = read_bytes(journals[side])

    if side in row.by:
        (record,) = journals[side].commit([Entry("s", trigger, BODIES.get(trigger))])
        assert (record.source, record.to, record.side) == (state, row.dest, side)
    else:
        with pytest.raises(IllegalTransition, match=f"{side} asked for '{trigger}' in state '{state}'"):
            journals[side].commit([Entry("s", trigger)])
        assert read_bytes(journals[side]) == stood


def test_the_table_above_reaches_every_state_that_a_trigger_can_leave():
    assert set(PATHS) == {source.value for row in SESSION_TRANSITIONS for source in row.sources}


@pytest.mark.parametrize("side", list(Side))
@pytest.mark.parametrize("event", list(GoalEvent))
def test_a_goal_or_node_event_is_recorded_for_its_own_sides_and_refused_to_the_others(open_journal, event, side):
    if event != GoalEvent.GOAL_SUBMITTED:
        open_journal().commit([Entry("goal:g", "goal_submitted", {"graph": "g", "seed": 0})])
    entry = Entry("goal:g" if event in {*GOAL_EVENTS, "goal_submitted"} else "node:g/n", event)
    journal = open_journal(side)
    stood = read_bytes(journal)

    if side is Side.AGENT or (side is Side.OPERATOR and event in OF_OPERATOR):
        (record,) = journal.commit([entry])
        assert (record.ev, record.side) == (event, side)
    else:
        with pytest.raises(IllegalEvent, match=f"the {side} may not record this"):
            journal.commit([entry])
        assert read_bytes(journal) == stood
