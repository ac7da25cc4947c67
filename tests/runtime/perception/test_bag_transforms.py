"""Places of cameras by the transforms of a bag: walked to the world, between two stamps, and nowhere else."""

import math

import numpy as np
import pytest

from phyagentos.geometry import Pose
from phyagentos.runtime.perception.bag_reader import Bag, Course

SECOND = 1_000_000_000
TURN = (math.cos(math.pi / 4), 0.0, 0.0, math.sin(math.pi / 4))  # a quarter about z


def make_course(*rows):
    """Rows of (stamp [s], x [m], angle about z [rad])."""
    values = [(x, 0.0, 1.0, math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2)) for _, x, angle in rows]
    stamps = np.array([round(at_s * SECOND) for at_s, *_ in rows], np.int64)
    return Course(stamps, np.array(values), np.zeros(len(rows), np.int64))


def make_bag(fixed=(), moving=(), unclear=()):
    frames = {child: (parent, np.array([*pose.position_m, *pose.quaternion_wxyz])) for child, parent, pose in fixed}
    frames |= {child: (parent, course) for child, parent, course in moving}
    frames |= {child: ("", frames[child][1]) for child in unclear}
    return Bag(begin_ns=0, end_ns=SECOND, types={}, pictures={}, joints={}, frames=frames)


FIXED = (("optical", "hand", Pose((1.0, 0.0, 0.0))), ("base", "world", Pose((0.0, 2.0, 0.0), TURN)))
MOVING = (("hand", "base", make_course((0.0, 0.0, 0.0), (0.1, 1.0, math.pi / 2), (0.9, 1.0, 0.0))),)


def find(bag, at_s, frame="optical", gap_s=0.15):
    return bag.find_pose(frame, "world", round(at_s * SECOND), round(gap_s * SECOND))


def test_a_chain_is_walked_and_a_turn_is_halved_between_two_stamps():
    bag = make_bag(FIXED, MOVING)

    for at_s, x, angle in ((0.0, 0.0, 0.0), (0.05, 0.5, math.pi / 4), (0.1, 1.0, math.pi / 2)):
        pose = find(bag, at_s)
        # in the base: (x, 0, 1) and a metre ahead of the hand; the base is turned by a quarter, two metres aside
        in_base = (x + math.cos(angle), math.sin(angle))
        assert np.allclose(pose.position_m, (-in_base[1], 2.0 + in_base[0], 1.0), atol=1e-9)
        half = (angle + math.pi / 2) / 2
        assert np.allclose(np.abs(pose.quaternion_wxyz), np.abs((math.cos(half), 0, 0, math.sin(half))), atol=1e-9)


@pytest.mark.parametrize("at_s", [-0.01, 0.5, 0.95])
def test_nothing_is_taken_from_beyond_the_stamps_or_across_a_gap(at_s):
    assert find(make_bag(FIXED, MOVING), at_s) == "no transform of hand within 0.15 s before and after its pictures"


@pytest.mark.parametrize(
    ("bag", "frame"),
    [
        (make_bag(FIXED[:1], MOVING), "base"),
        (make_bag((("optical", "a", Pose()), ("a", "b", Pose()), ("b", "a", Pose()))), "b"),
        (make_bag(FIXED, MOVING, ("base",)), "base"),
    ],
)
def test_a_broken_tree_says_where(bag, frame):
    why = f"no transform leads from world to optical: {frame} has no parent, two, or itself above it"
    assert find(bag, 0.05) == why
