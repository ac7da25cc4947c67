"""The way of a handle about a hinge: the hand turns with it, or stays level where the handle turns in the fingers."""

from types import SimpleNamespace

import numpy as np
import pytest

from phyagentos.geometry import Pose, compute_matrix, compute_pose, compute_tilt
from phyagentos.protocol.world.environment import Entity, Mechanism, Shape, ShapeKind
from phyagentos.runtime.execution.leaf import Status
from phyagentos.runtime.execution.leaves.find_opening import FindOpening
from phyagentos.runtime.motion.poses import point_tool_down

BAR = Shape(ShapeKind.CAPSULE, (0.01, 0.04))
TAB = Shape(ShapeKind.BOX, (0.02, 0.005, 0.01))
DOOR = Mechanism("hinge", (0.0, 0.0, 1.0), 1.5, Pose((0.5, 0.0, 0.1)))
LID = Mechanism("hinge", (0.0, 1.0, 0.0), 1.5, Pose((0.5, 0.0, 0.1)))


AHEAD = Pose((0.3, 0.0, 0.1))


def find(mechanism, shape, yaw_rad=0.0, opening=1.0, pose=AHEAD):
    """The leaf after it was ticked, and what it wrote; the handle is 0.2 m before the hinge."""
    handle = Entity(name="bar", kind="handle", pose=pose, shapes=(shape,), part_of="door")
    door = Entity(name="door", kind="door", pose=Pose((0.5, 0.0, 0.1)), joint=0.0, mechanism=mechanism)
    tcp = compute_pose(point_tool_down(yaw_rad, np.array((0.3, 0.0, 0.11))))
    world = SimpleNamespace(observe=lambda need: SimpleNamespace(entities={"door": door, "bar": handle}))
    context = SimpleNamespace(world=world, step=SimpleNamespace(target=SimpleNamespace(tcp=tcp)))
    leaf, values = FindOpening("way", context), {"object": "door", "part": "bar", "opening": opening}
    leaf.wire(values, {name: name for name in (*FindOpening.INPUT_PORTS, *FindOpening.OUTPUT_PORTS)})
    return leaf.on_start(), leaf, values


def test_a_hand_turns_with_the_tab_of_a_door():
    _, _, found = find(DOOR, TAB)
    end = compute_matrix(found["waypoints"][-1])

    angle = np.arctan2(end[1, 0], end[0, 0])
    assert angle == pytest.approx(1.5)
    np.testing.assert_allclose(end[:3, 3], (0.5 - 0.2 * np.cos(1.5), -0.2 * np.sin(1.5), 0.11), atol=1e-9)
    assert found["level"] == found["waypoints"]


def test_a_round_bar_along_the_hinge_may_turn_in_the_fingers_where_the_hand_cannot():
    _, _, found = find(DOOR, BAR)

    start = compute_matrix(found["level"][0])[:3, :3]
    assert all(np.allclose(compute_matrix(pose)[:3, :3], start) for pose in found["level"])
    assert compute_matrix(found["waypoints"][-1])[0, 0] == pytest.approx(np.cos(1.5))
    np.testing.assert_allclose(found["level"][-1].position_m, found["waypoints"][-1].position_m, atol=1e-9)


def test_fingers_that_close_along_the_hinge_keep_pointing_down_about_the_middle_of_the_handle():
    _, _, found = find(LID, TAB)

    assert all(compute_tilt(pose) == pytest.approx(np.pi) for pose in found["waypoints"])
    lifted = np.subtract(found["waypoints"][-1].position_m, (0.3, 0.0, 0.11))
    np.testing.assert_allclose(lifted, (0.2 - 0.2 * np.cos(1.5), 0.0, 0.2 * np.sin(1.5)), atol=1e-9)


def test_across_the_hinge_of_a_lid_the_hand_turns_with_it():
    _, _, found = find(LID, TAB, yaw_rad=np.pi / 2)

    assert compute_tilt(found["waypoints"][-1]) == pytest.approx(np.pi - 1.5)


def test_the_arc_is_followed_within_a_tenth_of_a_millimetre():
    _, _, found = find(DOOR, BAR)
    points = np.array([(0.3, 0.0, 0.11), *(pose.position_m for pose in found["waypoints"])])

    middles = (points[1:] + points[:-1]) / 2
    assert np.abs(np.linalg.norm(middles[:, :2] - (0.5, 0.0), axis=1) - 0.2).max() < 1e-4


def test_what_neither_slides_nor_turns_is_refused():
    status, leaf, _ = find(None, TAB)

    assert (status, leaf.code) == (Status.FAILURE, "IMPOSSIBLE")
    assert "door neither slides nor turns" in leaf.message


def test_where_a_handle_shall_be_is_said_of_its_middle_wherever_its_frame_is():
    """A drawer was to be pushed by its handle to where the frame of both would be: 10 cm too far, into the cabinet."""
    drawer = Mechanism("slide", (-1.0, 0.0, 0.0), 0.2, Pose((0.5, 0.0, 0.1)))
    own = Shape(TAB.kind, TAB.size_m, Pose((-0.2, 0.0, 0.0)))

    _, _, found = find(drawer, own, pose=Pose((0.5, 0.0, 0.1)))

    assert found["to"] == pytest.approx((0.1, 0.0, 0.1))
    assert found["to"] == pytest.approx(find(drawer, TAB)[2]["to"])


@pytest.mark.parametrize(("closes_at", "left_m"), [(0.1, 0.004), (0.05, 0.002), (0.002, 0.00008)])
def test_what_counts_as_closed_at_its_very_end_is_closed_further(closes_at, left_m):
    """A drawer that counts as closed in its last 5.9 % was to be pushed to 2 %, and came to 5 %."""
    drawer = Mechanism("slide", (-1.0, 0.0, 0.0), 0.2, Pose((0.5, 0.0, 0.1)), closes_at=closes_at)

    _, _, found = find(drawer, TAB, opening=0.02)

    assert found["to"] == pytest.approx((0.3 - left_m, 0.0, 0.1))


@pytest.mark.parametrize(
    ("axis", "beside_m", "ways_m"),
    [
        ((-1.0, 0.0, 0.0), (0.345, 0.0, 0.09), [(-0.018, 0.0, 0.0), (-0.218, 0.0, 0.0)]),
        ((0.0, 0.0, -1.0), (0.3, 0.0, 0.11), [(0.0, 0.0, -0.2)]),
    ],
)
def test_fingertips_hook_behind_what_slides_and_press_on_top_of_what_goes_down(axis, beside_m, ways_m):
    _, _, found = find(Mechanism("slide", axis, 0.2, Pose((0.5, 0.0, 0.1))), TAB)

    np.testing.assert_allclose(found["beside"], beside_m, atol=1e-9)
    np.testing.assert_allclose([move[:3, 3] for move in found["moves"]], ways_m, atol=1e-9)
    lines_m = [np.subtract(pose.position_m, (0.3, 0.0, 0.11)) for pose in found["push"]]
    np.testing.assert_allclose(lines_m, ways_m, atol=1e-9)
