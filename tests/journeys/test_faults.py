"""What goes wrong in the world is seen in the evidence, and repaired by a child where it can be."""

from pathlib import Path

import pytest

from phyagentos.agent.judging.review import review_session
from phyagentos.agent.judging.verifier import SessionVerifier
from phyagentos.assembly.agent_plane import open_agent
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.settings.verification_mode import VerificationMode
from phyagentos.store.journal import Journal

HERE = Path(__file__).parent
CLOCK = SystemClock()

pytestmark = pytest.mark.journey


def read_facts(report):
    return [(each.id, each.state, each.verdict) for each in report.sessions]


def review(plane, report):
    """Review every session of a goal that has just ended; the states that they were left in."""
    journal = Journal(plane.workspace.root, side=Side.AGENT, by="reviewer", clock=CLOCK)
    sessions = journal.open_ledger().sessions
    ended = [sessions[each.id] for each in report.sessions]
    for status in ended:
        assert review_session(plane.workspace, journal, status, SessionVerifier()).is_review
    journal.close()
    return {status.state for status in ended}


@pytest.mark.parametrize(
    ("fault", "cause"),
    [("slip", "GRASP_LOST"), ("nudge", "OBJECT_MOVED"), ("stall", "STALLED")],
)
def test_a_recoverable_fault_is_named_and_ends_in_a_child_that_succeeds(plane, fault, cause):
    report = plane.run(f"{fault}-1")

    assert report.verdict == "success", report
    assert read_facts(report)[0] == (f"{fault}-1.red", "replanned", "replan")
    assert read_facts(report)[-1] == (f"{fault}-1.red.r{len(report.sessions) - 1}", "succeeded", "success")
    assert not report.first_attempt_success["red"]
    struck = (plane.bundle(f"{fault}-1.red") / "faults.json").read_text()
    assert f'"kind": "{fault}"' in struck
    parent, child = (plane.mission.ledger.sessions[each.id] for each in report.sessions[:2])
    assert len(parent.attempts) == 1, "the parent of a child is immutable"
    assert parent.decision.cause == cause
    assert child.contract.parent == parent.contract.id
    assert child.contract.seed != parent.contract.seed
    assert review(plane, report) == {"replanned", "succeeded"}


def test_what_a_session_out_of_time_holds_is_put_down_by_the_next_one(plane, tmp_path):
    """Three attempts dropped it from 17 cm, one after the other, and none had the time to do it all."""
    short = tmp_path / "short.yaml"
    short.write_text((HERE / "goal.yaml").read_text().replace("timeout_s: 60", "timeout_s: 4"))
    report = plane.run("short-7", short, seed=7)

    assert report.verdict == "success", report
    assert read_facts(report) == [
        ("short-7.red", "replanned", "replan"),
        ("short-7.red.r1", "succeeded", "success"),
    ]
    parent, child = (plane.mission.ledger.sessions[each.id] for each in report.sessions)
    assert (parent.decision.cause, child.contract.skill) == ("TIMED_OUT", "place")


def test_a_removed_object_ends_in_failure(plane):
    report = plane.run("remove-1")

    assert report.verdict == "failure"
    assert report.exit_code == 1
    assert len(report.sessions) <= 3
    assert [each.truth for each in report.criteria if each.kind == "accept"] == ["unknown"], "nobody sees where it went"


def test_a_skill_whose_leaves_all_succeed_and_move_nothing_ends_failed(plane):
    report = plane.run("lie-1", "lie.yaml")

    assert {each.ended for each in report.sessions} == {"completed"}
    assert report.verdict == "failure"
    assert report.sessions[-1].state == "failed"
    assert "red_cube is not inside red_tray" in report.sessions[-1].reason
    assert "failed" in review(plane, report)


def test_verdicts_are_skipped_where_verification_is_off_and_can_be_given_by_a_review(plane):
    with open_agent(plane.workspace, CLOCK, by="unverified", verify=VerificationMode.OFF) as agent:
        report = agent.mission.run(HERE / "goal.yaml", seed=3, goal="calm-3")
    assert review(plane, report) == {"unverified"}
