"""The truth table's generator, on few cases."""

import pytest

from benchmarks import verdicts
from benchmarks.oracle.scorers import LET_GO
from benchmarks.recorded import open_robot
from benchmarks.verdict_parts.cases import FAILURES, SUCCESS, UNPLANNED
from benchmarks.verdict_parts.recordings import Studio, list_jobs
from benchmarks.verdict_parts.sensing import make_sensing
from benchmarks.verdict_parts.table import build_figures, rate_false_failure, rate_false_success
from benchmarks.verdict_parts.worlds import World
from phyagentos.protocol.sessions.verdicts import Verdict

pytestmark = pytest.mark.motion


@pytest.fixture(scope="module")
def robot():
    return open_robot()


@pytest.fixture(scope="module")
def recorded(robot, tmp_path_factory):
    """One real session of three skills, and one that failed."""
    studio = Studio(robot, tmp_path_factory.mktemp("recorded"))
    wanted = {"pick", "pick_and_place", "close_drawer"}
    return [studio.record(job, 11) for job in list_jobs(0) if job.name in wanted]


def test_every_shipped_skill_has_cases_and_every_class_that_was_asked_for_exists():
    skills = {job.skill for job in list_jobs(0)}
    assert skills >= {
        "home", "inspect", "pick", "place", "pick_and_place", "push", "stack", "carry_level", "close_drawer",
    }  # fmt: skip
    names = {kind.name for kinds in FAILURES.values() for kind in kinds} | {UNPLANNED.name}
    assert names >= {
        "closed on air", "slipped late", "wrong object", "right place but fallen", "on the rim",
        "stacked instead of inside", "moved back afterwards", "occluded", "object swapped", "sensor stale",
        "picture frozen", "cameras silent", "still sliding", "beside a round support", "through a plate",
        "under a cover", "wrong object unseen", "moved before the replan", "unnamed in the tray",
        "beside a step placed in a frame", "drawer nearly closed", "unplanned success of a failed primitive",
    }  # fmt: skip


def test_on_the_truth_no_verdict_is_wrong_and_the_controller_is(robot, recorded):
    outcomes = []
    for one in recorded:
        world = World.open(robot, one)
        eye, sensings = verdicts.open_eye(world), [make_sensing("truth", robot, world)]
        success = UNPLANNED if one.job.fault else SUCCESS
        for index, kind in enumerate((success, *(() if one.job.fault else FAILURES[one.job.name]))):
            outcomes += verdicts.judge_case(world, eye, kind, sensings, index)
    assert len(outcomes) > 20
    assert (rate_false_success(outcomes).value, rate_false_failure(outcomes).value) == (0.0, 0.0)
    figures = build_figures(outcomes, ["truth"])
    assert figures["false_success_controller"] == 1.0  # it said ok each time
    unplanned = next(each for each in outcomes if each.kind == UNPLANNED.name)
    assert (unplanned.controller_ok, unplanned.attempt.verdict) == (False, Verdict.SUCCESS)


def test_cameras_tell_which_thing_is_in_the_hand(robot, recorded):
    world = World.open(robot, next(one for one in recorded if one.job.name == "pick"))
    eye, sensings = verdicts.open_eye(world), [make_sensing("nominal", robot, world)]
    kinds = (SUCCESS, *(kind for kind in FAILURES["pick"] if kind.name in {"wrong object", "closed on air"}))
    outcomes = [o for kind in kinds for o in verdicts.judge_case(world, eye, kind, sensings, 5)]
    assert [(each.met, each.accepted) for each in outcomes] == [(True, True), (False, False), (False, False)]
    assert {each.attempt.sensing for each in outcomes} == {"perceived"}


@pytest.mark.parametrize(("skill", "is_let_go"), [("pick_and_place", True), ("pick", False)])
def test_an_object_counts_as_put_down_in_its_tray_and_not_while_it_is_held(skill, is_let_go, recorded):
    bundle = next(one.bundle for one in recorded if one.job.skill == skill and not one.job.fault)
    asked = {"cube": ["red_cube", "red_tray"]}
    assert LET_GO.score(asked, bundle.folder.parents[1], bundle.folder) == {"cube": is_let_go}
