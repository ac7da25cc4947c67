"""The last of the journeys: what the journals and logs of all of them went through is what the tables say."""

import pytest

from phyagentos.protocol.sessions.lifecycle import SESSION_TRANSITIONS
from phyagentos.runtime.supervision.target_phase import PHASE_TRANSITIONS

from .reached import list_arrows, read_phase_arrows, read_session_arrows

pytestmark = pytest.mark.journey


@pytest.mark.parametrize(
    ("rows", "read"),
    [(SESSION_TRANSITIONS, read_session_arrows), (PHASE_TRANSITIONS, read_phase_arrows)],
    ids=["session", "target"],
)
def test_journeys_reach_every_row_and_no_other(rows, read, journeys, is_of_every_journey):
    declared, reached = list_arrows(rows), read(journeys)

    assert reached <= declared, f"undeclared: {sorted(reached - declared)}"
    if is_of_every_journey:
        assert reached == declared, f"unreached: {sorted(declared - reached)}"
