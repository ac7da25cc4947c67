"""Encoders measure late and with noise that can be repeated."""

import numpy as np
import pytest

from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.runtime.drivers.mujoco.joint_sensors import ForceEstimate, JointSensors

PANDA = read_target(find_shipped_root() / "robots" / "panda" / "target.yaml")
ARM = PANDA.arm
Q, QD = np.linspace(-1.0, 1.0, 7), np.full(7, 2.0)


def test_measured_joints_have_the_noise_and_the_delay_of_the_profile():
    sensors = JointSensors(ARM, 3, 0.002)
    measured = np.array([sensors.measure(Q, QD, 0.002 * step) for step in range(2000)])  # (2000, 2, 7)
    q, qd = measured[:, 0] - Q, measured[:, 1] - QD
    assert q.mean() == pytest.approx(-ARM.state_delay_s * 2.0, abs=1e-5)
    assert (q.std(), qd.std()) == pytest.approx((ARM.position_noise_rad, ARM.velocity_noise_rad_s), rel=0.05)


def test_the_same_seed_and_time_measure_the_same():
    first, other = (JointSensors(ARM, seed, 0.002).measure(Q, QD, 0.5)[0] for seed in (3, 4))
    assert np.array_equal(JointSensors(ARM, 3, 0.002).measure(Q, QD, 0.5)[0], first)
    assert not np.array_equal(first, other)


def test_a_contact_force_is_estimated_with_a_bias_noise_and_a_dead_zone():
    estimates = [ForceEstimate(PANDA, seed, 0.002) for seed in range(40)]
    found = np.array([[each.measure(20.0, 0.002 * k) for k in range(200)] for each in estimates])

    biases = found.mean(axis=1) - 20.0
    assert 0.5 < np.abs(biases).max() <= 0.81
    assert 0.03 < found.std(axis=1).mean() < 0.04
    assert np.abs(found - 20.0).max() < estimates[0].error_n == 2.0
    assert [estimates[0].is_felt(np.array([torque, 0.0])) for torque in (0.9, -1.1)] == [False, True]
