"""Hold conditions are sampled, the worst sample is kept, and the first violation is reported."""

import math

from phyagentos.protocol.environment import Entity, Environment, Pose
from phyagentos.protocol.verdicts import Truth
from phyagentos.runtime.execution.holds import HoldMonitor

TEXT = "tilt(cup) <= 0.35"


def build_world(time_s, tilt_rad):
    pose = Pose((0.5, 0.0, 0.1), (math.cos(tilt_rad / 2), math.sin(tilt_rad / 2), 0.0, 0.0))
    cup = Entity(name="cup", kind="cup", pose=pose, observed_at_s=time_s)
    return Environment(time_s=time_s, scene="s", episode="e", revision=1, sensing="truth", entities={"cup": cup})


def test_the_worst_sample_is_kept_with_its_time():
    monitor = HoldMonitor([TEXT], build_world(0.0, 0.0), "panda")
    for time_s, tilt in ((0.1, 0.05), (0.2, 0.2), (0.3, 0.1)):
        assert monitor.sample(build_world(time_s, tilt)) is None

    (criterion,) = monitor.read_worst()
    assert (criterion.text, criterion.truth, criterion.at_s) == (TEXT, Truth.TRUE, 0.2)


def test_a_violation_is_reported_and_stays_the_worst():
    monitor = HoldMonitor([TEXT], build_world(0.0, 0.0), "panda")

    violated = monitor.sample(build_world(0.1, 0.5))
    assert violated.truth is Truth.FALSE
    monitor.sample(build_world(0.2, 0.1))

    assert monitor.read_worst() == (violated,)


def test_samples_are_due_ten_times_a_second_and_never_without_conditions():
    world = build_world(0.0, 0.0)

    assert [tick for tick in range(1, 16) if HoldMonitor([TEXT], world, "panda").is_due(tick)] == [5, 10, 15]
    assert not HoldMonitor([], world, "panda").is_due(5)
