"""A verdict that is formed again from frames: equal, or every difference is named."""

import msgspec
import pytest

from phyagentos.agent.judging.review import judge_again
from phyagentos.agent.judging.verifier import History, SessionVerifier
from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.looks import LookEntry, LookRole
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.world.environment import Pose
from phyagentos.protocol.world.truth import Truth

from .conftest import change, make_world, put
from .test_verifier import IN_TRAY, make_bundle, make_session

HOLD = "tilt(red_cube) <= 0.1"
BEFORE, AFTER = make_world(), put(make_world(), "red_cube", IN_TRAY)
TILTED = Pose((0.4, 0.0, 0.02), (0.995, 0.0995, 0.0, 0.0))


def make_entry(role, text=""):
    return LookEntry(file=f"look-{role}{len(text)}.zip", sha256="", role=role, time_s=1.0, text=text)


@pytest.fixture
def bundle():
    held = Criterion(text=HOLD, kind="hold", truth=Truth.TRUE, measured={"tilt_rad": 0.0}, evidence="holds.json")
    session = make_session(requires=("visible(red_cube)",), hold=(HOLD,))
    return msgspec.structs.replace(make_bundle(AFTER, session=session), before=BEFORE, holds=(held,))


def judge(bundle, before=BEFORE, after=AFTER, samples=()):
    seen = [(make_entry(LookRole.START), before), (make_entry(LookRole.END), after), *samples]
    decision = SessionVerifier().judge(bundle, History())
    return judge_again(bundle, [each for each in seen if each[1] is not None], SessionVerifier(), decision)


def test_the_same_snapshots_give_the_same_verdict(bundle):
    again = judge(bundle, samples=[(make_entry(LookRole.WORST, HOLD), BEFORE)])
    assert (again.verdict, again.differences, again.looks) == ("success", (), 3)
    assert [each.kind for each in again.criteria] == ["requires", "accept", "hold"]


def test_an_object_that_is_perceived_elsewhere_changes_acceptance_verdict_and_snapshot(bundle):
    again = judge(bundle, after=BEFORE)
    assert again.verdict == "failure"
    assert "environment_after.json: red_cube perceived otherwise" in again.differences
    assert any(text.startswith("accept inside(red_cube, red_tray): false") for text in again.differences)
    assert "verdict: failure, was success" in again.differences


def test_a_precondition_that_did_not_hold_is_a_difference(bundle):
    before = change(BEFORE, "red_cube", visible=False)
    assert any(text.startswith("requires visible(red_cube)") for text in judge(bundle, before=before).differences)


def test_a_hold_condition_is_evaluated_again_on_the_sample_that_was_kept(bundle):
    sample = change(BEFORE, "red_cube", pose=TILTED)
    again = judge(bundle, samples=[(make_entry(LookRole.WORST, HOLD), sample)])
    assert any(text.startswith(f"hold {HOLD}: false") for text in again.differences)
    assert again.verdict == "failure"


def test_a_sample_that_was_unknown_has_to_be_unknown_again(bundle):
    again = judge(bundle, samples=[(make_entry(LookRole.UNKNOWN, HOLD), BEFORE)])
    assert again.differences == (f"hold {HOLD} at 1.000 s: true, was unknown",)


@pytest.mark.parametrize(("missing", "role"), [("before", "start"), ("after", "end")])
def test_a_snapshot_whose_look_is_gone_cannot_be_judged_again(bundle, missing, role):
    with pytest.raises(ExecutionError, match=f"EVIDENCE_DAMAGED.*no look of the {role}, but a snapshot of it"):
        judge(bundle, **{missing: None})
