"""Hold conditions are sampled, the worst sample is kept, and the first violation is reported."""

import math

import msgspec
import pytest

from phyagentos.protocol.world.environment import Entity, Environment, Interior, Pose, Status, TargetState
from phyagentos.protocol.world.truth import Truth
from phyagentos.runtime.execution.holds import HoldMonitor
from phyagentos.runtime.targets.wire import Step

TEXT = "tilt(cup) <= 0.35"


def build_world(time_s, tilt_rad, tilt_std_rad=0.0):
    pose = Pose((0.5, 0.0, 0.1), (math.cos(tilt_rad / 2), math.sin(tilt_rad / 2), 0.0, 0.0))
    cup = Entity(name="cup", kind="cup", pose=pose, observed_at_s=time_s, tilt_std_rad=tilt_std_rad)
    return Environment(time_s=time_s, scene="s", episode="e", revision=1, sensing="truth", entities={"cup": cup})


def test_the_worst_sample_is_kept_with_its_time():
    monitor = HoldMonitor([TEXT], build_world(0.0, 0.0), "panda")
    for time_s, tilt in ((0.1, 0.05), (0.2, 0.2), (0.3, 0.1)):
        assert monitor.sample(build_world(time_s, tilt)) is None

    (criterion,) = monitor.read_worst()
    assert (criterion.text, criterion.truth, criterion.at_s) == (TEXT, Truth.TRUE, 0.2)


def test_samples_are_due_as_often_as_asked_and_never_without_conditions():
    world = build_world(0.0, 0.0)

    assert [tick for tick in range(1, 16) if HoldMonitor([TEXT], world, "panda").is_due(tick)] == [5, 10, 15]
    assert [tick for tick in range(1, 6) if HoldMonitor([TEXT], world, "panda", every=2).is_due(tick)] == [2, 4]
    assert not HoldMonitor([], world, "panda").is_due(5)


def test_the_twin_of_what_is_named_is_looked_at_too_since_it_may_be_the_one_that_is_meant():
    world = build_world(0.0, 0.0)
    cup = world.entities["cup"]
    twins = {
        name: msgspec.structs.replace(cup, name=name, alternatives=(other,))
        for name, other in (("cup", "cup_b"), ("cup_b", "cup"))
    }
    other = msgspec.structs.replace(cup, name="jug")
    told_apart = msgspec.structs.replace(world, entities={"cup": cup, "jug": other})
    alike = msgspec.structs.replace(world, entities={**twins, "jug": other})

    assert HoldMonitor([TEXT], told_apart, "panda").need.objects == {"cup"}
    assert HoldMonitor([TEXT], alike, "panda").need.objects == {"cup", "cup_b"}


def test_a_condition_on_the_target_alone_needs_no_look_and_keeps_none():
    """It took seconds a sample to look at everything, for what the target reports at every step."""
    monitor = HoldMonitor(["standing(target, 0.65)"], build_world(0.0, 0.0), "walker")
    assert not monitor.need.is_look
    assert HoldMonitor(["count(exists(*)) >= 1"], build_world(0.0, 0.0), "walker").need.is_look
    lying = Pose((0.0, 0.0, 0.1), (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0))
    state = TargetState(q_rad=(), qd_rad_s=(), gripper_width_m=0.0, tcp=Pose(), trunk=lying)
    fallen = msgspec.structs.replace(build_world(0.1, 0.0), targets={"walker": state})
    assert monitor.sample(fallen, look=object()).truth is Truth.FALSE
    assert monitor.samples == {}


def test_what_windows_measure_too_coarsely_is_looked_at_with_everything_every_half_second():
    monitor = HoldMonitor([TEXT], build_world(0.0, 0.0), "panda")
    wanted = []
    for tick in range(1, 14):
        monitor.sample(build_world(tick / 8, 0.3, tilt_std_rad=0.05))
        wanted.append(monitor.need.everything)
    assert [tick for tick, is_wanted in enumerate(wanted, 1) if is_wanted] == [4, 9]

    monitor.sample(build_world(14 / 8, 0.0))
    assert not monitor.need.everything


def test_of_a_session_that_ended_before_the_first_sample_the_snapshot_before_it_tells():
    (worst,) = HoldMonitor([TEXT], build_world(0.0, 0.0), "panda").read_worst()
    assert (worst.truth, worst.at_s) == (Truth.TRUE, 0.0)


def feel(monitor, *forces_n):
    state = TargetState(q_rad=(), qd_rad_s=(), gripper_width_m=0.0, tcp=Pose((0.0, 0.0, 0.0)))
    for number, force_n in enumerate(forces_n):
        time_s = 0.02 * number
        step = Step(time_s=time_s, target=state, tracking_error_rad=0.0, contact_force_n=force_n)
        if violated := monitor.feel(step, lambda _, time_s=time_s: build_world(time_s, 0.0)):
            return violated
    return None


def test_a_force_spike_of_one_report_violates_at_once_and_stays_the_worst():
    monitor = HoldMonitor(["metric(peak_force_n) <= 20"], build_world(0.0, 0.0), "panda")
    violated = feel(monitor, 0.0, 3.0, 31.0)
    assert (violated.truth, violated.measured, violated.at_s) == (Truth.FALSE, {"peak_force_n": 31.0}, 0.04)
    assert feel(monitor, 0.0) is None  # nothing new
    assert monitor.read_worst() == (violated,)


def test_a_force_within_its_bound_holds_and_asks_for_no_look():
    monitor = HoldMonitor(["metric(peak_force_n) <= 20"], build_world(0.0, 0.0), "panda")
    assert feel(monitor, 0.0, 12.0, 3.0) is None
    assert not monitor.is_due(5)
    assert [(each.truth, each.measured) for each in monitor.read_worst()] == [(Truth.TRUE, {"peak_force_n": 12.0})]


def test_a_target_that_feels_nothing_leaves_no_sample_of_a_force():
    monitor = HoldMonitor(["metric(peak_force_n) <= 20"], build_world(0.0, 0.0), "panda")
    assert feel(monitor, None, None) is None
    assert monitor.read_worst() == ()


def test_a_ball_that_was_spilled_on_the_way_is_told_though_it_lies_in_the_cup_again():
    def fill(time_s, away_m):
        world = build_world(time_s, 0.0)
        cup = msgspec.structs.replace(world.entities["cup"], interior=Interior((0.0, 0.0, 0.0), (0.03, 0.03, 0.04)))
        balls = [
            Entity(name=f"ball_{number}", kind="ball", pose=Pose((0.5 + way_m, 0.0, 0.1)), observed_at_s=time_s)
            for number, way_m in enumerate((0.0, away_m))
        ]
        return msgspec.structs.replace(world, entities={each.name: each for each in (cup, *balls)})

    monitor = HoldMonitor(["count(inside(*, cup)) >= 2"], fill(0.0, 0.0), "panda")
    assert monitor.sample(fill(0.1, 0.0)) is None
    assert monitor.sample(fill(0.2, 0.15)).measured["count"] == 1
    assert monitor.sample(fill(0.3, 0.0)) is None
    (worst,) = monitor.read_worst()
    assert (worst.truth, worst.at_s) == (Truth.FALSE, 0.2)


def hide(time_s):
    world = build_world(time_s, 0.0)
    hidden = msgspec.structs.replace(world.entities["cup"], status=Status.HIDDEN)
    return msgspec.structs.replace(world, sensing="perceived", entities={"cup": hidden})


@pytest.mark.parametrize(
    ("hidden_s", "last_s", "expected"),
    [
        ((), 4.0, Truth.TRUE),
        ((1.0, 1.5, 2.0), 2.5, Truth.TRUE),  # a moment, and seen again
        ((1.0, 1.5, 2.0, 2.5), 4.0, Truth.UNKNOWN),  # long enough to be carried away and back
        ((3.0, 3.5), None, Truth.UNKNOWN),  # not seen again
        ((3.0, 3.5), 3.9, Truth.UNKNOWN),  # nor in the last look
    ],
)
def test_what_was_hidden_for_a_moment_must_be_confirmed_and_for_longer_it_is_unknown(hidden_s, last_s, expected):
    monitor = HoldMonitor([TEXT], build_world(0.0, 0.0), "panda")
    for time_s in (0.5, *hidden_s):
        monitor.sample(hide(time_s) if time_s in hidden_s else build_world(time_s, 0.0))
    if last_s is not None:
        monitor.sample(hide(last_s) if last_s == 3.9 else build_world(last_s, 0.0), is_last=True)
    (criterion,) = monitor.read_worst()
    assert criterion.truth is expected


def test_a_violation_before_or_after_a_hidden_moment_stays_one():
    monitor = HoldMonitor([TEXT], build_world(0.0, 0.0), "panda")
    monitor.sample(hide(0.5))
    assert monitor.sample(build_world(0.6, 0.5)).truth is Truth.FALSE
    monitor.sample(hide(0.7), is_last=True)
    assert monitor.read_worst()[0].truth is Truth.FALSE
