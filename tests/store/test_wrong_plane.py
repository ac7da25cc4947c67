"""A record from the wrong plane is refused by the journal, whatever it says and wherever the session stands."""

import pytest

from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.admission import Entry, GoalEvent, IllegalEvent

AMENDMENTS = ("amendment_asked", "goal_amended", "amendment_refused")
GOAL_EVENTS = ("goal_compiled", "budget_spent", "goal_verdict", "goal_cancelled", *AMENDMENTS)
OF_OPERATOR = ("goal_submitted", "goal_cancelled", "amendment_asked")


def read_bytes(journal) -> bytes:
    return b"".join(path.read_bytes() for path in sorted(journal.folder.glob("*.md")))


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
