"""Each simulated target has a world of its own: where those of a goal do not agree, nothing is known."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from phyagentos.agent.judging.goal_judgement import Evidence, judge_goal
from phyagentos.protocol.sessions.evidence import Bundle
from phyagentos.protocol.sessions.session import Ended, Execution, SessionStatus
from phyagentos.protocol.sessions.verdicts import Verdict
from phyagentos.protocol.world.environment import Entity, Environment, Pose, TargetState
from phyagentos.protocol.world.truth import Truth
from phyagentos.testing import make_contract


class Told(Evidence):
    """Bundles that are told: after each session the mark in the world of its target stands so high [m]."""

    def __init__(self, heights_m) -> None:
        super().__init__(Path())
        self._heights_m = heights_m

    def _read(self, status, with_course):
        target = status.contract.target
        state = TargetState(q_rad=(0.0,), qd_rad_s=(0.0,), gripper_width_m=0.0, tcp=Pose(), holding=())
        mark = Entity(name="mark", kind="mark", pose=Pose((0.0, 0.0, self._heights_m[status.contract.id])))
        now = Environment(
            time_s=0.0, scene="s", episode="e", revision=1, sensing="truth", entities={"mark": mark},
            targets={target: state},
        )  # fmt: skip
        return Bundle(
            folder=Path(), session=status.contract, execution=status.execution, before=None, after=now, holds=(),
            trace=(), events=(),
        )  # fmt: skip


def judge(accept, *constraints, worlds=None, **heights_m):
    evidence = Told(heights_m)
    for id in heights_m:
        execution = Execution(ended=Ended.COMPLETED, evidence=f"evidence/{id}")
        contract = make_contract(id=id, node=id, target=f"{id}_arm")
        evidence.read(SessionStatus(contract=contract, state="awaiting_verification", execution=execution))
    choices = {id: SimpleNamespace(target=f"{id}_arm") for id in heights_m}
    graph = SimpleNamespace(
        rescuers={},
        nodes={},
        spec=SimpleNamespace(
            accept=(accept,), constraints=constraints, targets={}, worlds=worlds or {}, interchangeable=()
        ),
        choices=choices,
    )
    return judge_goal(graph, evidence, {})


@pytest.mark.parametrize(("left", "right"), [(0.19, 0.1), (0.1, 0.19)])
def test_worlds_that_disagree_leave_the_goal_unmet_whichever_ended_last(left, right):
    outcome = judge("height(mark) >= 0.15", left=left, right=right)
    (criterion,) = outcome.criteria
    assert (outcome.verdict, criterion.truth) == (Verdict.FAILURE, Truth.UNKNOWN)
    assert "in the world of left_arm" in criterion.because
    assert "in the world of right_arm" in criterion.because


def test_a_constraint_must_be_seen_true_at_the_end_of_the_goal():
    assert judge("height(mark) >= 0.15", "height(mark) <= 0.3", left=0.19).verdict is Verdict.SUCCESS
    for constraint, truth in (
        ("visible(mark) and upright(other)", Truth.UNKNOWN),
        ("height(mark) <= 0.1", Truth.FALSE),
    ):
        outcome = judge("height(mark) >= 0.15", constraint, left=0.19)
        assert outcome.verdict is Verdict.FAILURE
        assert (outcome.criteria[0].kind, outcome.criteria[0].truth) == ("constraint", truth)
    metric = judge("height(mark) >= 0.15", "metric(peak_force_n) <= 20", left=0.19)  # each session answered for its own
    assert metric.verdict is Verdict.SUCCESS


@pytest.mark.parametrize(("left", "right", "met"), [(0.19, 0.1, False), (0.1, 0.19, True)])
def test_in_a_world_that_the_goal_names_the_latest_snapshot_counts(left, right, met):
    outcome = judge("height(mark) >= 0.15", worlds={"table": ("left_arm", "right_arm")}, left=left, right=right)
    assert (outcome.verdict is Verdict.SUCCESS) is met
    assert outcome.criteria[0].evidence.startswith("evidence/right/")


def test_a_target_beside_the_named_world_has_its_own():
    criteria = judge(
        "height(mark) >= 0.15", worlds={"table": ("left_arm", "right_arm")}, left=0.1, right=0.2, far=0.1
    ).criteria
    assert "false in the world of far_arm, true in the world of left_arm and right_arm" in criteria[0].because


def test_what_names_a_target_is_asked_of_its_world():
    assert judge("not holding(left_arm, mark)", left=0.19, right=0.1).criteria[0].truth is Truth.TRUE
