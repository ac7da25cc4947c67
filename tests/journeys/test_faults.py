"""What goes wrong in the world is seen in the evidence, and repaired by a child where it can be."""

import pytest

pytestmark = pytest.mark.journey


def read_facts(report):
    return [(each.id, each.state, each.verdict) for each in report.sessions]


@pytest.mark.parametrize("fault", ["slip", "nudge", "move", "stall"])
def test_a_recoverable_fault_ends_in_a_child_that_succeeds(plane, fault):
    report = plane.run(f"{fault}-1")

    assert report.verdict == "success", report
    assert read_facts(report)[0] == (f"{fault}-1.red", "replanned", "replan")
    assert read_facts(report)[-1] == (f"{fault}-1.red.r{len(report.sessions) - 1}", "succeeded", "success")
    assert not report.first_attempt_success["red"]
    struck = (plane.bundle(f"{fault}-1.red") / "faults.json").read_text()
    assert f'"kind": "{fault}"' in struck
    parent, child = (plane.mission.ledger.sessions[each.id] for each in report.sessions[:2])
    assert len(parent.attempts) == 1, "the parent of a child is immutable"
    assert child.contract.parent == parent.contract.id
    assert child.contract.seed != parent.contract.seed


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
    assert "inside(red_cube, red_tray)" in report.sessions[-1].reason
