"""Each judge alone: what it reads, what it says, and that it fails closed."""

import hashlib

import msgspec
import numpy as np
import pytest

from phyagentos.agent.judging.judges.metrics import TRAJECTORY_METRICS, HoldJudge, MetricJudge
from phyagentos.agent.judging.judges.predicates import LookaheadJudge, PredicateJudge
from phyagentos.agent.judging.verifier import SessionVerifier
from phyagentos.protocol.predicates.measured import METRICS
from phyagentos.protocol.sessions.calibration import TrackRecord
from phyagentos.protocol.sessions.evidence import TRAJECTORY, Event, read_bundle, write_json
from phyagentos.protocol.sessions.lookahead import LOOKAHEAD, LookaheadRequest, LookaheadResult
from phyagentos.protocol.sessions.session import Ended, Execution
from phyagentos.protocol.sessions.trace import TraceEvent
from phyagentos.protocol.sessions.verdicts import Criterion, Verdict
from phyagentos.protocol.world.environment import FRESH_S, SensorHealth
from phyagentos.protocol.world.truth import Truth

from .conftest import make_world
from .test_verifier import BUDGET, DONE, make_bundle, make_session

ASKING = make_session(lookahead=LookaheadRequest())
ROWS = 6


def write_trajectory(folder, **arrays):
    facts = {
        "time_s": np.arange(ROWS) * 0.02,
        "q_commanded": np.zeros((ROWS, 2)),
        "q_measured": np.zeros((ROWS, 2)),
        "qd_measured": np.zeros((ROWS, 2)),
        "gripper_measured_m": np.full(ROWS, 0.08),
    }
    np.savez(folder / TRAJECTORY, **(facts | arrays))


def judge_metric(text, folder=None, **more):
    bundle = make_bundle(DONE, session=make_session(accept=(text,)), **({"folder": folder} if folder else {}) | more)
    (criterion,) = MetricJudge().judge(bundle)
    return criterion


def with_sensors(status):
    """The world after the session, by cameras of which one has never shown a change."""
    sensors = {"left": SensorHealth(status="unproven"), "right": SensorHealth(status=status)}
    return msgspec.structs.replace(DONE, sensors=sensors)


LATER = {"before": msgspec.structs.replace(make_world(), time_s=3.0, revision=9)}


@pytest.mark.parametrize(
    ("after", "facts", "truth", "because"),
    [
        pytest.param(
            msgspec.structs.replace(DONE, time_s=FRESH_S + 0.5),
            {},
            Truth.UNKNOWN,
            "red_cube was last seen 1.5 s before; up to 1 s is allowed",
            id="what was seen long before the end",
        ),
        pytest.param(
            with_sensors("unproven"), {}, Truth.UNKNOWN, "move something in its view", id="cameras that never changed"
        ),
        pytest.param(with_sensors("live"), {}, Truth.TRUE, "", id="one camera that did"),
        pytest.param(
            DONE, LATER, Truth.UNKNOWN, "older than the one before it", id="a snapshot older than the one before"
        ),
        pytest.param(
            DONE,
            LATER | {"execution": {"ended": Ended.TARGET_LOST}},
            Truth.TRUE,
            "",
            id="a world that began anew counts its time anew",
        ),
    ],
)
def test_acceptance_needs_facts_that_were_observed_at_the_end(after, facts, truth, because):
    (criterion,) = PredicateJudge().judge(make_bundle(after, **facts))
    assert criterion.truth is truth
    assert because in criterion.because


def test_a_spilled_cup_is_told_by_its_worst_sample_though_it_stands_upright_now():
    text = "count(inside(*, cup)) >= 8"
    worst = Criterion(text=text, kind="hold", truth=Truth.FALSE, at_s=2.0, measured={"count": 5}, because="5 of 8")
    session = make_session(hold=(text, "upright(bottle)"))
    spilled, unsampled = HoldJudge().judge(make_bundle(DONE, session=session, holds=(worst,)))
    assert spilled is worst
    assert (unsampled.truth, unsampled.because) == (Truth.UNKNOWN, "it was never sampled")


def test_a_condition_on_a_metric_is_judged_by_the_whole_trajectory(tmp_path):
    write_trajectory(tmp_path, force_n=np.array([0.0, 2.0, 2.0, 0.0, 31.0, 0.0]))  # after the last sample
    session = make_session(hold=("metric(peak_force_n) <= 20", "metric(peak_tracking_error_rad) <= 0.1"))
    sampled = Criterion(text=session.hold[0], kind="hold", truth=Truth.TRUE, measured={"peak_force_n": 2.0})
    force, error = HoldJudge().judge(make_bundle(DONE, session=session, holds=(sampled,), folder=tmp_path))
    assert (force.truth, force.kind, force.measured) == (Truth.FALSE, "hold", {"peak_force_n": 31.0})
    assert error.truth is Truth.TRUE


@pytest.mark.parametrize(
    ("execution", "truth", "because"),
    [
        pytest.param({}, Truth.UNKNOWN, "nothing measured peak_force_n", id="a force that nothing felt"),
        pytest.param(
            {"ticks": 0, "code": "ALREADY_MET"},
            Truth.TRUE,
            "ALREADY_MET: no control period was commanded",
            id="what was not commanded pressed on nothing",
        ),
    ],
)
def test_a_condition_on_a_force_without_a_measurement(tmp_path, execution, truth, because):
    write_trajectory(tmp_path)
    session = make_session(hold=("metric(peak_force_n) <= 20",))
    (force,) = HoldJudge().judge(make_bundle(DONE, session=session, folder=tmp_path, execution=execution))
    assert (force.truth, force.because) == (truth, because)


@pytest.mark.parametrize(
    ("text", "truth"),
    [
        ("metric(final_joint_speed_rad_s) <= 0.1", Truth.FALSE),
        ("metric(peak_joint_speed_rad_s) <= 0.2", Truth.TRUE),
        ("metric(peak_joint_acceleration_rad_s2) <= 9", Truth.FALSE),
        ("metric(final_tracking_error_rad) <= 0.02", Truth.TRUE),
        ("metric(peak_tracking_error_rad) <= 0.02", Truth.FALSE),
        ("metric(final_gripper_width_m) > 0.03", Truth.TRUE),
        ("metric(final_rest_s) > 0.059", Truth.TRUE),  # since the third of six periods
        ("metric(final_rest_s) > 0.061", Truth.FALSE),
        ("metric(peak_force_n) <= 1", Truth.UNKNOWN),  # what a skill says of itself is none
    ],
)
def test_numbers_of_the_trajectory(tmp_path, text, truth):
    moving, lagging = np.zeros((ROWS, 2)), np.zeros((ROWS, 2))
    moving[-1, 0], lagging[1, 1] = 0.2, -0.03
    write_trajectory(tmp_path, qd_measured=moving, q_measured=lagging)
    own_word = {"ended": Ended.COMPLETED, "outputs": {"peak_force_n": 0.0}}
    assert judge_metric(text, tmp_path, execution=own_word).truth is truth


def test_a_number_that_is_none_is_unknown(tmp_path):
    write_trajectory(tmp_path, qd_measured=np.full((ROWS, 2), np.nan))
    assert judge_metric("metric(peak_joint_speed_rad_s) <= 1", tmp_path).truth is Truth.UNKNOWN


def test_a_controllers_own_word_counts_only_where_the_goal_asks_for_what_was_reported():
    event = TraceEvent(
        tick=1, time_s=1.0, path="a", leaf="verify_grasp", status="SUCCESS", numbers={"width_m": 0.04, "labels": ["a"]}
    )
    execution = {"ended": Ended.COMPLETED, "outputs": {"depth_m": 0.01, "site": [0, 1]}, "interventions": 2}
    more = {"trace": (event,), "execution": execution}
    assert judge_metric("metric(reported_width_m) >= 0.03", **more).truth is Truth.TRUE
    assert judge_metric("metric(reported_depth_m) < 0.01", **more).truth is Truth.FALSE
    unasked = judge_metric("metric(width_m) >= 0.03", **more)
    assert (unasked.truth, unasked.because) == (Truth.UNKNOWN, "nothing measured width_m")
    assert judge_metric("metric(depth_m) >= 0.0", **more).truth is Truth.UNKNOWN
    more["execution"]["outputs"] |= {"interventions": 0, "ticks": 0}
    assert judge_metric("metric(interventions) <= 0", **more).measured == {"interventions": 2.0}


@pytest.mark.parametrize("damage", [None, b"", b"no archive", b"PK\x03\x04 cut off"])
def test_what_nobody_measured_or_can_read_is_unknown(tmp_path, damage):
    if damage is not None:
        (tmp_path / TRAJECTORY).write_bytes(damage)
    criterion = judge_metric("metric(peak_tracking_error_rad) <= 1", tmp_path)
    assert (criterion.truth, criterion.because) == (Truth.UNKNOWN, "nothing measured peak_tracking_error_rad")


def test_metrics_and_facts_are_asked_in_one_criterion():
    mixed = judge_metric("inside(red_cube, red_tray) and metric(ticks) <= 100")
    assert mixed.truth is Truth.TRUE
    assert PredicateJudge().judge(make_bundle(DONE, session=make_session(accept=(mixed.text,)))) == []


def test_criteria_of_the_settings_hold_for_every_session():
    verifier = SessionVerifier(judges=(PredicateJudge(), MetricJudge(("metric(interventions) <= 0",))))
    attempt = verifier.judge(make_bundle(DONE, execution={"interventions": 1}), BUDGET)
    assert attempt.verdict is not Verdict.SUCCESS
    assert [(c.kind, c.truth) for c in attempt.criteria] == [("accept", "true"), ("metric", "false")]
    assert attempt.judges == ("predicates/2", "metrics/1(metric(interventions) <= 0)")


def write_lookahead(folder, **facts):
    result = LookaheadResult(
        **({"samples": 16, "succeeded": 4, "threshold": 0.7, "causes": {"GRASP_LOST": 12}} | facts)
    )
    write_json(folder / LOOKAHEAD, result)


def test_without_rollouts_and_where_no_forecaster_was_fit_to_be_asked_look_ahead_has_nothing_to_say(tmp_path):
    worse = {"hasty/1": TrackRecord(cases=31, brier=0.4, base_brier=0.2)}
    bundle = make_bundle(DONE, session=ASKING, folder=tmp_path)
    assert LookaheadJudge().judge(bundle) == []
    write_json(tmp_path / LOOKAHEAD, LookaheadResult(samples=0, succeeded=0, threshold=0.7, withheld=worse))
    assert LookaheadJudge().judge(bundle) == []


def test_the_share_of_rollouts_is_compared_with_the_threshold_that_was_asked(tmp_path):
    write_lookahead(tmp_path)
    (criterion,) = LookaheadJudge().judge(make_bundle(DONE, session=ASKING, folder=tmp_path))
    assert (criterion.text, criterion.truth, criterion.kind) == ("lookahead >= 0.7", Truth.FALSE, "lookahead")
    assert criterion.because == "4 of 16 rollouts met the acceptance; the others failed with GRASP_LOST (12)"


@pytest.mark.parametrize("data", [b"{", b'{"samples": 0, "succeeded": 0, "threshold": 0.7}'])
def test_rollouts_that_cannot_be_read_or_never_ended_are_unknown(tmp_path, data):
    (tmp_path / LOOKAHEAD).write_bytes(data)
    (criterion,) = LookaheadJudge().judge(make_bundle(DONE, session=ASKING, folder=tmp_path))
    assert criterion.truth is Truth.UNKNOWN


@pytest.mark.parametrize(("after", "succeeded", "verdict"), [(DONE, 0, "success"), (make_world(), 16, "replan")])
def test_a_prediction_never_outvotes_what_was_observed(tmp_path, after, succeeded, verdict):
    write_lookahead(tmp_path, succeeded=succeeded)
    attempt = SessionVerifier().judge(make_bundle(after, session=ASKING, folder=tmp_path), BUDGET)
    assert attempt.verdict == verdict
    assert attempt.criteria[-1].kind == "lookahead"


def test_a_prediction_decides_where_nothing_was_observed(tmp_path):
    write_lookahead(tmp_path)
    verifier = SessionVerifier(judges=(LookaheadJudge(),))
    assert verifier.judge(make_bundle(DONE, session=ASKING, folder=tmp_path), BUDGET).verdict is not Verdict.SUCCESS


def test_a_judgement_names_every_file_it_read_by_its_hash(tmp_path):
    write_trajectory(tmp_path)
    write_json(tmp_path / "environment_before.json", make_world())
    write_json(tmp_path / "environment_after.json", DONE)
    (tmp_path / "events.jsonl").write_bytes(msgspec.json.encode(Event(time_s=0.0, kind="timing")) + b"\n")
    session = make_session(accept=("inside(red_cube, red_tray)", "metric(peak_tracking_error_rad) <= 1"))
    bundle = read_bundle(tmp_path, session, Execution(ended=Ended.COMPLETED, evidence="e"))
    attempt = SessionVerifier().judge(bundle, BUDGET)
    assert attempt.verdict is Verdict.SUCCESS
    read = ("environment_before.json", "environment_after.json", "events.jsonl", TRAJECTORY)
    assert {reference.file: reference.sha256 for reference in attempt.evidence} == {
        name: hashlib.sha256((tmp_path / name).read_bytes()).hexdigest() for name in read
    }


def test_every_metric_of_a_trajectory_can_be_named():
    assert TRAJECTORY_METRICS.keys() <= {*METRICS}
