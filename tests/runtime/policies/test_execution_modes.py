"""Each field of `policy.execution` decides what is commanded when; without it the same policy moves another way."""

from types import SimpleNamespace

import numpy as np
import pytest

from phyagentos.runtime.execution.skill_runtime import SkillStatus
from tests.runtime.policies.stand import PERIOD_S, ROWS, Stand

LOCKSTEP = {"realtime": False}
WAY = 0.002  # of joint 1 in one control period [rad]


def walk(profile, rows=ROWS, last=np.inf, way=WAY):
    """A policy that goes on from where the arm stands; `last` is the number of its last chunk."""
    home = np.array(profile.arm.home_rad)

    def infer(request):
        out = np.tile(np.append(home, 1.0), (rows, 1))
        out[:, 0] = request.observations["joint_state"].reshape(-1, 7)[-1, 0] + way * np.arange(1, rows + 1)
        return out, request.sequence >= last

    return infer


def hold(profile, offsets, rows=4):
    """A policy whose chunk i holds joint 1 at the i-th of these offsets from home."""
    home = np.array(profile.arm.home_rad)

    def infer(request):
        out = np.tile(np.append(home, 1.0), (rows, 1))
        out[:, 0] += offsets[request.sequence]
        return out, request.sequence == len(offsets) - 1

    return infer


def read_rows_done(stand):
    return [request.rows_done for request in stand.asked]


@pytest.mark.parametrize(
    ("execution", "rate_hz", "expected"),
    [
        ({}, 50.0, [0, 16, 32, 48]),
        ({"mode": "open_loop"}, 50.0, [0, 20, 40, 60]),
        ({"mode": "open_loop", "horizon": 3}, 50.0, [0, 20, 40, 60]),
        ({"mode": "receding_horizon"}, 50.0, [0, 16, 32, 48]),
        ({"mode": "receding_horizon", "horizon": 8}, 50.0, [0, 8, 16, 24]),
        ({"mode": "receding_horizon", "horizon": 8}, 25.0, [0, 16, 32, 48]),
        ({"mode": "hard_switch", "horizon": 1}, 50.0, [0, 1, 2, 3]),
        ({"mode": "temporal_ensemble"}, 50.0, [0, 1, 2, 3]),
        ({"mode": "temporal_ensemble", "horizon": 5}, 50.0, [0, 5, 10, 15]),
    ],
)
def test_a_policy_is_asked_again_at_the_horizon_of_its_mode(profile, execution, rate_hz, expected):
    stand = Stand(profile, walk(profile, last=3), execution=execution, rate_hz=rate_hz, **LOCKSTEP)
    assert stand.run() is SkillStatus.SUCCEEDED, stand.runtime.find_failure()
    assert read_rows_done(stand) == expected


@pytest.mark.parametrize(("mode", "late"), [("hard_switch", 1), ("receding_horizon", 5)])
def test_a_chunk_that_comes_early_waits_for_the_horizon_or_takes_over_at_once(profile, mode, late):
    how = {"mode": mode, "horizon": 8}
    stand = Stand(profile, walk(profile), delay_s=PERIOD_S, execution=how)  # asked for 5 periods ahead
    stand.run(turns=40)
    assert {event.numbers["late"] for event in stand.runtime.trace()[1:]} == {late}


def test_an_open_loop_is_shown_what_its_whole_chunk_has_led_to(profile):
    stand = Stand(profile, walk(profile), delay_s=PERIOD_S, execution={"mode": "open_loop"})
    stand.run(turns=60)
    assert read_rows_done(stand)[1] == ROWS
    shown = stand.asked[1].observations["joint_state"][0]
    assert shown == pytest.approx(profile.arm.home_rad[0] + WAY * ROWS), "in real time, too, and not ahead of its end"


@pytest.mark.parametrize("decay", [0.0, 0.5, 50.0])
def test_an_ensemble_commands_the_weighted_mean_of_all_that_speak_of_a_moment(profile, decay):
    offsets = 1e-3 * np.array([1.0, 3.0, 2.0, 5.0, 4.0, 4.0, 1.0, 0.0])
    how = {"mode": "temporal_ensemble", "ensemble_decay": decay}
    stand = Stand(profile, hold(profile, offsets), execution=how, **LOCKSTEP)
    assert stand.run() is SkillStatus.SUCCEEDED
    for now, joint in enumerate(stand.joint[: len(offsets) - 1]):
        speaking = offsets[max(0, now - 3) : now + 1]  # chunks of four rows, the oldest first
        weights = np.exp(-decay * np.arange(len(speaking)))
        assert joint - profile.arm.home_rad[0] == pytest.approx(float(weights @ speaking / weights.sum()), abs=1e-9)


@pytest.mark.parametrize(("expiry_s", "expected"), [(None, [0, 16, 32]), (0.1, [0, 6, 12]), (0.2, [0, 11, 22])])
def test_rows_beyond_the_expiry_are_not_commanded_any_more(profile, expiry_s, expected):
    how = {} if expiry_s is None else {"expiry_s": expiry_s}
    stand = Stand(profile, walk(profile, last=2), execution=how, **LOCKSTEP)
    stand.run(turns=60)
    assert read_rows_done(stand)[:3] == expected, "rows at the age of the expiry are the last ones"


def test_a_chunk_that_has_expired_when_it_comes_is_left_out_whole(profile):
    stand = Stand(profile, walk(profile), delay_s=0.08, execution={"expiry_s": 0.06})
    assert stand.run() is SkillStatus.FAILED
    assert stand.runtime.find_failure().code == "POLICY_LOST"
    assert stand.joint == [], "nothing old was commanded"


@pytest.mark.parametrize("underrun", ["wait", "brake", "continue", "fail"])
def test_what_happens_when_rows_run_out_is_declared(profile, underrun):
    how = {"horizon": 8, "underrun": underrun}
    stand = Stand(profile, walk(profile), delay_s=0.2, execution=how)  # asked for 5 periods ahead, comes 5 periods late
    status = stand.run(turns=25)
    before, gap = stand.speed[:8], stand.speed[8:13]
    assert np.array(before[1:]) == pytest.approx(WAY / PERIOD_S, rel=0.1)
    if underrun == "fail":
        assert (status, stand.runtime.find_failure().code) == (SkillStatus.FAILED, "POLICY_LOST")
    elif underrun == "continue":
        assert gap == pytest.approx([WAY / PERIOD_S] * 5, rel=0.1), "the rows beyond the horizon"
    elif underrun == "brake":
        assert gap[0] == 0.0, "a tenth of a radian a second is little to brake"
        assert len(stand.joint) < 25 - 10 - 3, "at rest nothing is commanded"
    else:
        assert 0.0 not in stand.speed[:12], "the next chunk goes on from the set-point that stood"


@pytest.mark.parametrize(("interruption", "rests_by"), [("row", 6), ("chunk", 17)])
def test_a_pause_takes_hold_where_the_skill_declares_it_and_the_policy_sees_the_present_again(
    profile, interruption, rests_by
):
    stand = Stand(profile, walk(profile), execution={"interruption": interruption}, **LOCKSTEP)
    stand.run(turns=6)
    assert len(stand.joint) == 5
    stand.pauses = True
    stand.run(turns=40)
    assert len(stand.joint) == rests_by
    assert stand.speed[-1] == 0.0
    assert len(stand.asked) == 1, "a policy at rest is asked nothing"
    moved = stand.q = stand.q + 0.01  # somebody moves the arm meanwhile
    stand.pauses = False
    stand.run(turns=2)
    assert stand.asked[1].observations["joint_state"] == pytest.approx(moved)


@pytest.mark.parametrize(("duration_s", "periods"), [(0.3, 15), (1.0, 50)])
def test_a_policy_that_never_says_done_is_done_after_its_duration_and_brakes(profile, duration_s, periods):
    stand = Stand(profile, walk(profile), execution={"duration_s": duration_s}, **LOCKSTEP)
    assert stand.run() is SkillStatus.SUCCEEDED
    assert len(stand.joint) == periods + 1, "one to brake"
    assert stand.speed[-1] == 0.0


def test_a_history_shows_the_samples_as_far_apart_as_its_stream_declares(profile):
    stand = Stand(profile, walk(profile), history=3, execution={"horizon": 8}, **LOCKSTEP)
    stand.run(turns=20)
    home = profile.arm.home_rad[0]
    first, second = (request.observations["joint_state"] for request in stand.asked[:2])
    assert first.shape == (3, 7)
    assert first[:, 0] == pytest.approx([home] * 3), "the oldest is repeated"
    assert second[:, 0] == pytest.approx(home + WAY * np.array([6.0, 7.0, 8.0]), abs=1e-6), "50 Hz: a period apart"


@pytest.mark.parametrize("rate_hz", [10.0, 25.0, 50.0])
def test_a_row_lasts_a_period_of_the_policys_own_rate(profile, rate_hz):
    stand = Stand(profile, walk(profile, last=0), rate_hz=rate_hz, **LOCKSTEP)
    assert stand.run() is SkillStatus.SUCCEEDED
    assert len(stand.joint) == ROWS * 50 / rate_hz
    assert stand.joint[-1] - profile.arm.home_rad[0] == pytest.approx(WAY * ROWS)


def test_an_answer_to_what_was_shown_before_a_pause_is_not_carried_out_after_it(profile):
    stand = Stand(profile, walk(profile), delay_s=0.2, execution={"interruption": "row"})
    stand.run(turns=23)  # the second request is out
    done = len(stand.joint)
    stand.pauses = True
    stand.run(turns=2)
    stand.pauses = False
    stand.run(turns=12)
    assert stand.speed[-1] == 0.0
    assert len(stand.joint) == done + 1, "one to brake, and nothing of the chunk that came meanwhile"
    stand.run(turns=12)
    assert [request.sequence for request in stand.asked] == [0, 1, 2]
    assert stand.asked[2].rows_done == done + 1
    assert len(stand.joint) > done + 1


@pytest.mark.parametrize(("every_s", "stops_at"), [(None, 68), (0.02, 10), (0.1, 10), (0.16, 16)])
def test_a_policy_counts_as_done_once_a_look_shows_that_the_acceptance_holds(profile, monkeypatch, every_s, stops_at):
    """The stand's world is the number of commands; ten of them meet the acceptance."""
    monkeypatch.setattr("phyagentos.runtime.policies.policy_runtime.is_met", lambda session, now, before: now >= 10)
    stand = Stand(profile, walk(profile, last=3), execution={"until_met_s": every_s}, **LOCKSTEP)
    stand.context.world = SimpleNamespace(observe=lambda need: len(stand.joint))
    stand.context.initial = 0

    assert stand.run() is SkillStatus.SUCCEEDED
    assert stand.speed[-1] == 0.0 or every_s is None, "it comes to rest before it ends"
    moved = [index for index, speed in enumerate(stand.speed) if speed]
    assert len(moved) == pytest.approx(stops_at, abs=2)


def test_a_pause_within_the_last_chunk_is_no_end_of_it(profile):
    stand = Stand(profile, walk(profile, last=0), execution={"interruption": "row"}, **LOCKSTEP)
    stand.run(turns=6)
    stand.pauses = True
    assert stand.run(turns=10) is SkillStatus.RUNNING, "rows were left"
    stand.pauses = False
    assert stand.run() is SkillStatus.SUCCEEDED
    assert len(stand.asked) == 2


@pytest.mark.parametrize("interruption", ["row", "chunk"])
@pytest.mark.parametrize(("way", "mode"), [(0.0022, "hard_switch"), (0.01, "hard_switch"), (0.01, "temporal_ensemble")])
def test_a_policy_that_goes_on_after_a_pause_is_brought_up_to_its_speed(profile, way, mode, interruption):
    stand = Stand(profile, walk(profile, way=way), execution={"mode": mode, "interruption": interruption}, **LOCKSTEP)
    stand.run(turns=30)
    stand.pauses = True
    stand.run(turns=30)
    assert stand.speed[-1] == 0.0
    rested, at = len(stand.joint), stand.joint[-1]
    stand.pauses = False
    stand.run(turns=40)
    bends = np.abs(np.diff(stand.rows[10 * rested - 1 :], n=2)) / 0.002**2
    assert bends.max() < 0.9 * profile.arm.acceleration_rad_s2[0], "the guard refuses more"
    assert stand.speed[-1] == pytest.approx(way / PERIOD_S, rel=0.05)
    assert np.abs(np.array(stand.joint[rested:]) - at - 8 * way).min() < 1e-4, "the same way, later"


def swing(profile, way_rad, duration_s, rate_hz):
    """A policy that swings joint 1 by `way_rad` with the least jerk, at a rate of its own."""
    home = np.array(profile.arm.home_rad)

    def infer(request):
        s = np.clip((request.time_s + np.arange(1, ROWS + 1) / rate_hz) / duration_s, 0.0, 1.0)
        out = np.tile(np.append(home, 1.0), (ROWS, 1))
        out[:, 0] += way_rad * s**3 * (10 - 15 * s + 6 * s**2)
        return out, request.time_s > duration_s

    return infer


@pytest.mark.parametrize("execution", [{"mode": "open_loop"}, {"horizon": 2}, {"mode": "temporal_ensemble"}])
@pytest.mark.parametrize("rate_hz", [10.0, 15.0])
@pytest.mark.parametrize(("interpolation", "passes"), [("linear", False), ("cubic", True)])
def test_a_fast_motion_at_a_low_rate_has_no_corners_where_its_rows_lie_on_a_spline(
    profile, execution, rate_hz, interpolation, passes
):
    way_rad, duration_s = 0.6, 0.8  # least jerk: 5.4 rad/s^2 of 15
    infer = swing(profile, way_rad, duration_s, rate_hz)
    stand = Stand(profile, infer, rate_hz=rate_hz, execution=execution, interpolation=interpolation, **LOCKSTEP)
    assert stand.run() is SkillStatus.SUCCEEDED
    bends = np.abs(np.diff(stand.rows, n=2, prepend=[profile.arm.home_rad[0]] * 2)) / 0.002**2
    assert bool(bends.max() < profile.arm.acceleration_rad_s2[0]) is passes
    assert stand.joint[-1] - profile.arm.home_rad[0] == pytest.approx(way_rad, abs=1e-3)


def test_a_policy_whose_chunk_came_too_late_is_brought_up_to_its_speed_as_well(profile):
    how = {"horizon": 8, "underrun": "brake"}
    stand = Stand(profile, walk(profile, way=0.01), delay_s=0.3, execution=how)
    stand.run(turns=40)
    rested = stand.speed.index(0.0) + 1
    bends = np.abs(np.diff(stand.rows[10 * rested - 1 :], n=2)) / 0.002**2
    assert len(stand.joint) > rested + 5
    assert bends[:90].max() < 0.9 * profile.arm.acceleration_rad_s2[0], "the guard refuses more"
    assert stand.runtime.trace()[1].numbers["run_up"] > 0
