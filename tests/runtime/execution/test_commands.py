"""One tick's channels become one period of set-points; nobody sets any, and time stands."""

import numpy as np
import pytest

from phyagentos.runtime.execution.commands import CommandBuffer

N = 10


@pytest.fixture
def buffer():
    return CommandBuffer(
        q_rad=np.zeros(2), gripper_width_m=0.08, acceleration_rad_s2=np.array([10.0, 5.0]), n_steps=N, step_s=0.002
    )


def test_no_channel_means_no_command(buffer):
    assert buffer.take() is None


def test_an_unset_channel_holds_its_last_set_point(buffer):
    buffer.set_gripper(np.full(N, 0.02))
    points = buffer.take()

    assert np.array_equal(points.q_rad, np.zeros((N, 2)))
    buffer.set_arm(np.full((N, 2), 0.1), np.zeros((N, 2)))
    assert np.array_equal(buffer.take().gripper_width_m, np.full(N, 0.02))


def test_channels_are_empty_after_they_were_taken(buffer):
    buffer.hold()
    assert buffer.take() is not None

    assert buffer.take() is None


def test_an_abandoned_motion_is_braked_to_rest_within_the_limits(buffer):
    q = np.tile([0.02, -0.01], (N, 1))
    buffer.set_arm(q, np.tile([1.0, -0.5], (N, 1)))
    buffer.take()

    rows_q, rows_qd = [], []
    while (points := buffer.take()) is not None:
        rows_q.append(points.q_rad)
        rows_qd.append(points.qd_rad_s)
    qd = np.vstack(rows_qd)

    assert buffer.at_rest
    assert np.array_equal(qd[-1], [0.0, 0.0])
    changes = np.abs(np.diff(np.vstack(([1.0, -0.5], qd)), axis=0)) / 0.002
    assert (changes <= np.array([10.0, 5.0]) + 1e-9).all()
    travelled = np.vstack(rows_q)[-1] - q[-1]
    assert travelled == pytest.approx([0.1, -0.05], rel=1e-6)  # v^2 / (2 a), the slower joint in step


def test_hold_does_not_freeze_a_moving_arm(buffer):
    buffer.set_arm(np.zeros((N, 2)), np.ones((N, 2)))
    buffer.take()
    buffer.hold()

    assert buffer.take().qd_rad_s[0, 0] == pytest.approx(1.0, rel=0.05)


@pytest.mark.parametrize(
    ("rows", "found"),
    [
        (np.zeros((N, 3)), r"q_rad: expected finite numbers of shape \(10, 2\), found shape \(10, 3\)"),
        ([0.0, 0.0], r"found shape \(2,\)"),
        (np.full((N, 2), np.nan), r"found shape \(10, 2\) with nan"),
        ("open", "could not convert string to float: 'open'"),
        (None, r"q_rad: expected .*, found shape \(\)"),
    ],
)
def test_rows_that_are_no_command_are_refused_where_they_are_given(buffer, rows, found):
    with pytest.raises(ValueError, match=found):
        buffer.set_arm(rows, np.zeros((N, 2)))
    with pytest.raises(ValueError, match=r"width_m: expected|could not convert"):
        buffer.set_gripper(rows)
    assert buffer.take() is None
