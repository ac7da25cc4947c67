"""What is taken hold of where something is beside it, at a rim, and what is pushed past obstacles."""

import msgspec
import numpy as np
import pytest

from phyagentos.clock import SystemClock
from phyagentos.geometry import compute_matrix, compute_pose, make_matrix, to_child
from phyagentos.protocol.world.entity_geometry import compute_grasp_width
from phyagentos.protocol.world.environment import Entity, Mechanism, Pose, Shape, ShapeKind
from phyagentos.runtime.motion.grasps import find_grasps
from phyagentos.runtime.motion.job import Job
from phyagentos.runtime.motion.planning_scene import PlanningScenes
from phyagentos.runtime.motion.process import _ANSWERS
from phyagentos.runtime.motion.requests import (
    Approaches,
    Destination,
    FindGrasps,
    FindLine,
    FindPlacements,
    FindPush,
    NoPlan,
    Timing,
    World,
)
from phyagentos.runtime.motion.robot_model import measure_fingers
from phyagentos.runtime.motion.shapes import foresee_payload
from tests.runtime.motion.conftest import TABLE, build_box, build_cube, build_fixed

pytestmark = pytest.mark.motion


@pytest.fixture
def grasp(find, home):
    """The ways to take an object of a world, of which there is one at least."""

    def grasp(world, name):
        return find(FindGrasps(world=world, object=name, q_rad=home, seed=1))

    return grasp


def list_contacts(planner, world, q_rad, widths_m):
    scene = PlanningScenes(planner.robot).get_scene(world)
    return {pair for width in widths_m for pair in scene.sweep(q_rad, width, width)}


def pen_in(gap_m, high_m=0.02):
    """A cube of 30 mm with walls around it, `gap_m` away."""
    away_m = 0.0175 + gap_m
    walls = [build_box((0, side * away_m, high_m), (away_m, 0.0025, high_m)) for side in (-1, 1)]
    walls += [build_box((side * away_m, 0, high_m), (0.0025, away_m, high_m)) for side in (-1, 1)]
    return World((TABLE, build_fixed("pen", (0.5, 0.0, 0.0), *walls), build_cube("cube0", 0.5, 0.0, half=0.015)))


def test_an_object_whose_walls_open_fingers_would_straddle_is_refused(planner, home):
    """The guard stopped it as soon as the fingers closed: COLLISION, left_finger|brown_tray."""
    answer = planner.answer(FindGrasps(world=pen_in(0.012, 0.01), object="cube0", q_rad=home, seed=1))
    assert getattr(answer, "code", "") == "NO_IK", answer
    assert "left_finger|pen" in answer.rejected


@pytest.mark.parametrize("gap_m", [0.036, 0.045])
def test_fingers_go_between_an_object_and_the_wall_beside_it_and_sweep_no_wall_when_they_close(planner, home, gap_m):
    """Wide open, they would stand beyond the walls, and closing would take the walls along."""
    world = pen_in(gap_m)
    answer = planner.answer(FindGrasps(world=world, object="cube0", q_rad=home, seed=1))
    assert isinstance(answer, Approaches), answer
    _ANSWERS.encode(answer)
    for approach in answer.approaches:
        end_rad = approach.line_rad[-1]
        touched = list_contacts(planner, world, end_rad, np.linspace(0.03, approach.release_m, 12))
        assert {other for _, other in touched} <= {"cube0"}, approach.label


def test_a_lying_rod_is_closed_on_across_its_axis(grasp):
    """A capsule along x counted as round about z: the fingers came down on its ends."""
    lying = Shape(ShapeKind.CAPSULE, (0.0115, 0.032), Pose(quaternion_wxyz=(0.5**0.5, 0.0, 0.5**0.5, 0.0)))
    for yaw_rad in (0.0, 1.2):
        rod = msgspec.structs.replace(build_cube("rod", 0.5, 0.0, yaw=yaw_rad, z=0.0115), shapes=(lying,))
        for approach in grasp(World((TABLE, rod)), "rod"):
            w, x, y, z = approach.tcp_end.quaternion_wxyz
            closing = np.array(
                (2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z))
            )  # the tool's y axis, seen from above
            assert abs(closing @ (np.cos(yaw_rad), np.sin(yaw_rad))) < 0.01, approach.label


@pytest.mark.parametrize("error_m", [-0.012, 0.012])
def test_a_thin_object_whose_height_is_believed_wrong_is_met_above_its_support(planner, home, error_m):
    """None of 10 ways to grasp it worked (`left_finger|table`), and a push went over its top."""
    slab = build_cube("slab", 0.5, 0.0, z=0.007 + error_m)
    world = World((TABLE, msgspec.structs.replace(slab, shapes=(build_box((0, 0, 0), (0.03, 0.02, 0.007)),))))
    grasps = planner.answer(FindGrasps(world=world, object="slab", q_rad=home, seed=1))
    push = planner.answer(FindPush(world=world, object="slab", to_m=(0.6, 0.0), q_rad=home, seed=1))
    assert grasps.approaches[0].tcp_end.position_m[2] == pytest.approx(0.016, abs=1e-6)
    assert planner._chain.compute_tcp(push.approaches[0].line_rad[-1])[2, 3] == pytest.approx(0.018, abs=2e-4)


@pytest.mark.parametrize("error_m", [0.0, 0.004])
@pytest.mark.parametrize("is_seen", [True, False])
def test_what_stands_on_a_thin_board_is_not_taken_together_with_it(grasp, is_seen, error_m):
    """It was lowered through the board onto the table: no way to grasp it worked, or both came along."""
    board = msgspec.structs.replace(
        build_cube("board", 0.5, 0.0, z=0.004),
        shapes=(build_box((0, 0, 0), (0.03, 0.02, 0.004)),),
        pose=Pose((0.5, 0.0, 0.004), (1.0, 0.002, 0.0, 0.0)),
    )
    slab = msgspec.structs.replace(
        build_cube("slab", 0.5, 0.0, z=0.014 + error_m),
        shapes=(build_box((0, 0, 0), (0.03, 0.02, 0.006)),),
        position_std_m=0.0012,
    )
    tool_m = grasp(World((TABLE, slab, *([board] if is_seen else []))), "slab")[0].tcp_end.position_m[2]
    assert tool_m == pytest.approx(0.008 + 0.016 + (0.0 if is_seen else error_m), abs=2e-4)


@pytest.mark.parametrize("error_m", [0.0, 0.0027])
def test_a_flat_board_is_closed_on_with_the_fingertips_beside_it_and_off_the_table(grasp, error_m):
    """Of a board of 4.7 mm, or of one believed 2.7 mm too high, the fingers closed over its top, thrice in a row."""
    board = msgspec.structs.replace(
        build_cube("board", 0.5, 0.0, z=0.0024 + error_m), shapes=(build_box((0, 0, 0), (0.02, 0.02, 0.0024)),)
    )
    tips_m = grasp(World((TABLE, board)), "board")[0].tcp_end.position_m[2] - 0.010
    assert 0.0015 < tips_m < 0.0048 - 0.002


def build_bowl(x, y):
    """Ten flat walls that lean outwards, wider above than the hand opens."""
    base = Shape(ShapeKind.CYLINDER, (0.03, 0.002), Pose((0.0, 0.0, -0.013)))
    walls = []
    for turn in np.arange(10) * 0.2 * np.pi:
        c, s, a, b = np.cos(turn / 2), np.sin(turn / 2), np.cos(0.2), np.sin(0.2)
        pose = Pose((0.036 * np.cos(turn), 0.036 * np.sin(turn), 0.0), (c * a, -s * b, c * b, s * a))
        walls.append(Shape(ShapeKind.BOX, (0.002, 0.014, 0.015), pose))
    return msgspec.structs.replace(build_cube("bowl", x, y, z=0.016), shapes=(base, *walls))


def test_a_bowl_that_is_wider_than_the_hand_opens_is_taken_at_its_rim(planner, grasp):
    world = World((TABLE, build_bowl(0.5, 0.1)))
    for approach in grasp(world, "bowl"):
        assert approach.label.startswith("solid")
        assert 0.02 > approach.release_m - 0.004 > 0.01
        x, y, _ = approach.tcp_end.position_m
        assert np.hypot(x - 0.5, y - 0.1) == pytest.approx(0.04, abs=0.006)
        for q in approach.line_rad:
            assert list_contacts(planner, world, q, [approach.release_m]) == set(), approach.label


def test_an_angle_is_closed_on_where_both_pads_meet_it_near_its_weight(grasp):
    """In the middle of the box around it, one pad met air: the angle turned in the fingers and slipped out."""
    long, short = build_box((0, 0, 0), (0.04, 0.009, 0.009)), build_box((0.031, 0.029, 0), (0.009, 0.02, 0.009))
    ell = msgspec.structs.replace(build_cube("ell", 0.5, 0.0, yaw=0.4, z=0.009), shapes=(long, short))
    for approach in grasp(World((TABLE, ell)), "ell"):
        assert compute_grasp_width(ell, approach.tcp_end, 0.01, 0.018) == pytest.approx(0.018, abs=1e-4)
        x, y, _ = to_child(ell.pose, approach.tcp_end.position_m)
        assert (abs(x - 0.0103) < 0.005, abs(y) < 0.001) == (True, True), approach.label  # the weight: 10.3, 9.7 mm


def test_a_mug_is_closed_on_across_its_body_and_not_beside_it(grasp):
    """The box around it has its middle a centimetre from the body's axis, on the handle's side."""
    mug = build_mug()
    for approach in grasp(World((TABLE, mug)), "mug"):
        assert np.hypot(*to_child(mug.pose, approach.tcp_end.position_m)[:2]) < 0.002, approach.label


@pytest.mark.parametrize("high_m", [0.03, 0.038])
def test_a_tall_bottle_is_closed_on_by_more_than_the_edge_of_its_body(high_m, grasp):
    """The palm stops above the neck: pads that met a millimetre of the body's edge lost it on the way."""
    body = Shape(ShapeKind.CYLINDER, (0.023, high_m), Pose((0, 0, high_m)))
    neck = Shape(ShapeKind.CYLINDER, (0.01, 0.013), Pose((0, 0, 2 * high_m + 0.013)))
    bottle = msgspec.structs.replace(build_cube("bottle", 0.5, 0.0, z=0.0), shapes=(body, neck))
    for approach in grasp(World((TABLE, bottle)), "bottle"):
        z_m = approach.tcp_end.position_m[2]
        assert z_m <= 2 * high_m or z_m >= 2 * high_m + 0.0095, approach.label  # pads reach 9.5 mm down


def build_mug():
    """Eight walls 28 mm from an axis, and a handle."""
    shapes = [build_box((0.046, 0, 0.02), (0.004, 0.005, 0.02))]
    for turn in np.arange(8) * np.pi / 4:
        place = (0.028 * np.cos(turn), 0.028 * np.sin(turn), 0.02)
        pose = Pose(place, (float(np.cos(turn / 2)), 0.0, 0.0, float(np.sin(turn / 2))))
        shapes.append(Shape(ShapeKind.BOX, (0.002, 0.0125, 0.03), pose))
    return msgspec.structs.replace(build_cube("mug", 0.5, 0.0, yaw=0.3, z=0.01), shapes=tuple(shapes))


def test_a_push_turns_the_narrow_side_of_the_hand_towards_what_is_beside_its_way(planner, find, home):
    sides = [
        build_fixed(f"side{s:+d}", (0.5, s * 0.075, 0.06), build_box((0, 0, 0), (0.2, 0.01, 0.06))) for s in (-1, 1)
    ]
    world = World((TABLE, *sides, build_cube("cube0", 0.45, 0.0)))
    request = FindPush(world=world, object="cube0", to_m=(0.55, 0.0), q_rad=home, seed=1)
    in_the_open = find(msgspec.structs.replace(request, world=World((TABLE, world.entities[-1]))))
    assert {each.label[:8] for each in find(request)} <= {"push+090", "push+270"}
    assert {each.label[:8] for each in in_the_open} == {"push+000"}
    across_m, along_m = measure_fingers(planner.robot)
    assert 0.008 < across_m < 0.012 < along_m < 0.03
    tip_m = planner._chain.compute_tcp(in_the_open[0].line_rad[-1])[:3, 3]
    assert tip_m == pytest.approx((0.55 - 0.02 - across_m, 0.0, 0.02), abs=2e-3)


def test_an_object_is_pushed_around_what_is_in_its_straight_way(planner, find, home):
    """`No straight push brings brown_rod there`: nothing else was tried."""
    block = build_fixed("block", (0.5, 0.0, 0.06), build_box((0, 0, 0), (0.03, 0.06, 0.06)))
    at_m, goal_m = np.array((0.5, -0.2)), np.array((0.5, 0.2))
    pushes = 0
    while np.linalg.norm(at_m - goal_m) > 0.04 and pushes < 4:
        pushes += 1
        world = World((TABLE, block, build_cube("cube0", *at_m)))
        push = FindPush(world=world, object="cube0", to_m=tuple(goal_m), q_rad=home, seed=1)
        line = planner._chain.compute_tcp_path(find(push)[0].line_rad)[:, :2, 3]
        way_m = line[-1] - line[0]
        at_m = at_m + way_m - way_m / np.linalg.norm(way_m) * 0.03  # but for the gap before the contact
        assert abs(at_m[0] - 0.5) > 0.03 + 0.02 or abs(at_m[1]) > 0.06 + 0.02
    assert 1 < pushes < 4


@pytest.mark.parametrize(("aside_m", "is_straight"), [(0.035, False), (0.08, True)])
def test_an_object_is_pushed_around_what_it_would_run_into_itself(planner, home, aside_m, is_straight):
    """The hand passed beside a small cube, and the pushed can took it along."""
    objects = (TABLE, build_cube("cube0", 0.5, -0.15), build_cube("small", 0.5 + aside_m, 0.05, half=0.01))
    answer = planner.answer(FindPush(world=World(objects), object="cube0", to_m=(0.5, 0.25), q_rad=home, seed=1))
    ends = [each.tcp_end.position_m for each in answer.approaches]
    assert all((abs(x - 0.5) < 0.005 and y > 0.2) == is_straight for x, y, _ in ends)


def test_a_bar_is_taken_beside_its_middle_where_the_hand_has_no_room_over_it(grasp):
    """`None of 10 ways to grasp white_bar works`: a shelf stood beside its middle."""
    bar = msgspec.structs.replace(build_cube("bar", 0.5, 0.0), shapes=(build_box((0, 0, 0), (0.045, 0.012, 0.02)),))
    posts = [
        build_fixed(f"post{s:+d}", (0.46, s * 0.07, 0.1), build_box((0, 0, 0), (0.02, 0.02, 0.1))) for s in (-1, 1)
    ]
    for approach in grasp(World((TABLE, bar, *posts)), "bar"):
        assert ".by" in approach.label
        assert 0.01 < approach.tcp_end.position_m[0] - 0.5 < 0.03


def test_a_grasp_is_chosen_from_which_the_object_can_be_put_where_it_goes(planner, home):
    """The nearest grasp was taken; a hand beside a tall box then found no place, NO_IK."""
    request = FindGrasps(world=World((TABLE, build_cube("cube0", 0.5, 0.0))), object="cube0", q_rad=home, seed=1)
    scene, timing = PlanningScenes(planner.robot).get_scene(request.world), Timing(ms={})

    def find(answer):
        job = Job(clock=SystemClock(), should_cancel=lambda: False)
        return find_grasps(request, request.world.entities[1], planner._kinematics, scene, job, answer).approaches

    tilted = find(lambda way: None if "tilt-20" in way.label else NoPlan(code="NO_IK", message="", timing=timing))
    assert {each.label.partition(".")[2] for each in tilted} == {"tilt-20"}
    full = find(lambda way: NoPlan(code="NO_FREE_SITE", message="", timing=timing))  # however it is grasped
    assert [each.label for each in full] == [each.label for each in planner.answer(request).approaches]
    there = Destination("table", "on", (0.5, 0.3, 0.0))
    assert isinstance(planner.answer(msgspec.structs.replace(request, then=there)), Approaches)


def test_what_is_nearly_as_wide_as_the_hand_opens_is_taken_all_the_same(planner, home):
    """`grey_plate is wider than the gripper opens`: 76 mm of 80."""
    for radius_m, code in ((0.0385, ""), (0.0396, "NOT_GRASPABLE")):
        disc = Shape(ShapeKind.CYLINDER, (radius_m, 0.006))
        plate = msgspec.structs.replace(build_cube("plate", 0.5, 0.0, z=0.006), shapes=(disc,))
        answer = planner.answer(FindGrasps(world=World((TABLE, plate)), object="plate", q_rad=home, seed=1))
        assert getattr(answer, "code", "") == code, answer


def test_a_push_is_refused_with_its_reason(planner, home):
    world = World((TABLE, build_cube("cube0", 0.45, 0.0)))
    request = FindPush(world=world, object="cube0", to_m=(0.452, 0.0), q_rad=home, seed=1)
    assert planner.answer(request).code == "IMPOSSIBLE"
    assert planner.answer(msgspec.structs.replace(request, object="cub0", to_m=(0.6, 0.0))).code == "OBJECT_GONE"
    assert planner.answer(msgspec.structs.replace(request, to_m=(1.6, 0.0))).code == "NO_IK"


def cover(height_m):
    """A cube under a board on two walls, which is open towards the arm."""
    walls = [build_box((0, side * 0.19, height_m / 2), (0.06, 0.005, height_m / 2)) for side in (-1, 1)]
    board = build_box((0, 0, height_m + 0.006), (0.06, 0.195, 0.006))
    return World((TABLE, build_fixed("shelf", (0.5, 0.0, 0.0), board, *walls), build_cube("cube0", 0.47, 0.0)))


def test_under_a_board_the_hand_lies_and_comes_along_its_own_axis(planner, grasp):
    for approach in grasp(cover(0.16), "cube0"):
        poses = [planner._chain.compute_tcp(q) for q in approach.line_rad[[0, -1]]]
        way_m = poses[1][:3, 3] - poses[0][:3, 3]
        np.testing.assert_allclose(way_m / np.linalg.norm(way_m), poses[1][:3, 2], atol=1e-3)
        assert way_m[2] < 0.0  # and rises with the object on the way back
        touched = list_contacts(planner, cover(0.16), approach.line_rad[-1], (0.04, approach.release_m))
        assert {other for _, other in touched} <= {"cube0"}, approach.label


def put_on_post(shape, half_post_m):
    """Something 140 mm wide on a post, whose edges jut out on all sides."""
    post = build_fixed("post", (0.5, 0.0, 0.0), build_box((0, 0, 0.08), (half_post_m, half_post_m, 0.08)))
    plate = build_cube("plate", 0.5, 0.0, z=0.166)
    return World((TABLE, post, msgspec.structs.replace(plate, kind="plate", shapes=(shape,))))


DISC = Shape(ShapeKind.CYLINDER, (0.07, 0.006))
SLAB = Shape(ShapeKind.BOX, (0.07, 0.07, 0.006))


@pytest.mark.parametrize("shape", [DISC, SLAB], ids=["disc", "slab"])
def test_what_no_hand_spans_is_closed_on_from_above_and_below_at_an_edge_that_juts_out(planner, shape, grasp):
    for approach in grasp(put_on_post(shape, 0.035), "plate"):
        end = planner._chain.compute_tcp(approach.line_rad[-1])
        assert abs(end[2, 1]) == pytest.approx(1.0, abs=1e-3)  # the closing axis is vertical
        assert 0.058 < np.linalg.norm(end[:2, 3] - (0.5, 0.0)) < 0.066
        assert planner._chain.compute_tcp(approach.line_rad[0])[2, 3] > end[2, 3]


@pytest.mark.parametrize("shape", [DISC, SLAB], ids=["disc", "slab"])
def test_where_no_edge_juts_out_far_enough_it_is_too_wide(planner, home, shape):
    world = put_on_post(shape, 0.068)

    answer = planner.answer(FindGrasps(world=world, object="plate", q_rad=home, seed=1))

    assert getattr(answer, "code", "") == "NOT_GRASPABLE", answer
    assert "no edge that juts out is in reach" in answer.message


def test_a_hand_with_a_finger_underneath_leaves_sideways(planner, find, grasp):
    """It rose, took the plate along and threw it off the table."""
    world = put_on_post(DISC, 0.035)
    approach = grasp(world, "plate")[0]
    held = foresee_payload(world.entities[-1], approach)
    other = build_fixed("other", (0.48, 0.3, 0.0), build_box((0, 0, 0.08), (0.035, 0.035, 0.08)))
    world = World((*world.entities, other))

    places = FindPlacements(
        world=world, payload=held, destination="other", relation="on", q_rad=approach.line_rad[0], seed=1
    )
    for placed in find(places):
        start, end = (planner._chain.compute_tcp(q) for q in placed.line_rad[[0, -1]])
        back_m = start[:3, 3] - end[:3, 3]
        assert np.linalg.norm(back_m[:2]) > 4 * back_m[2] > 0.0


def test_a_handle_under_another_one_is_taken_from_its_front(grasp):
    """From above, the hand met what is over it."""
    how = Mechanism("slide", (-1.0, 0.0, 0.0), 0.15, Pose((0.6, 0.0, 0.15)))
    drawer = build_fixed("drawer", (0.6, 0.0, 0.15), build_box((0, 0, 0), (0.005, 0.1, 0.03)), mechanism=how, joint=0.0)
    bar, roof = build_box((-0.03, 0, 0), (0.007, 0.04, 0.007)), build_box((0.07, 0, 0.14), (0.11, 0.12, 0.01))
    handle = msgspec.structs.replace(build_cube("bar", 0.6, 0.0, z=0.15), shapes=(bar,), part_of="drawer")
    world = World((TABLE, build_fixed("chest", (0.6, 0.0, 0.13), roof), drawer, handle))

    assert grasp(world, "bar")[0].label.startswith("front")


def test_a_ball_is_as_thick_between_the_pads_as_it_is_there():
    """Fingers had slipped up to the crown of a ball; the box around it was too wide to be between them, so none was."""
    shape = Shape(ShapeKind.SPHERE, (0.034,), Pose((0.0, 0.0, 0.0)))
    ball = Entity(name="ball", kind="ball", pose=Pose((0.5, 0.0, 0.034)), shapes=(shape,))
    crown = Pose((0.5, 0.0, 0.073), (0.0, 1.0, 0.0, 0.0))  # pointing down, 5 mm above the ball
    assert compute_grasp_width(ball, crown, 0.012, 0.034) == pytest.approx(0.034, abs=0.008)
    assert compute_grasp_width(ball, Pose((0.5, 0.0, 0.09), crown.quaternion_wxyz), 0.012, 0.034) is None
    middle = Pose((0.5, 0.0, 0.034), crown.quaternion_wxyz)
    assert compute_grasp_width(ball, middle, 0.012, 0.08) == pytest.approx(0.068, abs=1e-6)


def test_of_grasps_those_come_first_from_which_the_arm_can_follow_what_it_moves(planner, find, home):
    """The upright hand that is nearest cannot go so far outwards."""
    world, move = World((build_cube("handle", 0.6, 0.1, z=0.2),)), make_matrix(np.eye(3), np.array((0.2, 0.0, 0.0)))
    request = FindGrasps(world=world, object="handle", q_rad=home, seed=1)
    leading = find(msgspec.structs.replace(request, moves=(move,)))

    assert "tilt" not in find(request)[0].label
    for approach in leading:
        waypoints = (compute_pose(move @ compute_matrix(approach.tcp_end)),)
        line = FindLine(world=World(()), q_rad=approach.line_rad[-1], seed=1, waypoints=waypoints)
        assert isinstance(planner.answer(line), Approaches)
