"""How far an agent has acted on the journal, as the runtime reads it."""

from phyagentos.protocol.sessions.session import GoalId
from phyagentos.store.turn_marks import TurnMarks

GOAL = GoalId("tidy-7")


def test_a_mark_is_replaced_whatever_stood_there(tmp_path):
    assert TurnMarks(tmp_path).read(GOAL) == 0
    TurnMarks(tmp_path).note(GOAL, 1_234_567)
    TurnMarks(tmp_path).note(GOAL, 89)  # of a workspace whose journal began anew
    assert TurnMarks(tmp_path).read(GOAL) == 89


def test_a_mark_of_an_earlier_version_is_replaced(tmp_path):
    (tmp_path / "turns").mkdir()
    (tmp_path / "turns" / GOAL).write_bytes(b"12\n")
    assert TurnMarks(tmp_path).read(GOAL) == 12
    TurnMarks(tmp_path).note(GOAL, 13)
    assert TurnMarks(tmp_path).read(GOAL) == 13
