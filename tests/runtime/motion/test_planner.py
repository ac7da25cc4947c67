"""Whole pick and place requests: found, within limits, free of contact, repeatable."""

from itertools import product

import msgspec
import mujoco
import numpy as np
import pytest

from phyagentos.geometry import compute_inverse, compute_matrix, compute_pose, convert_euler
from phyagentos.protocol.world.environment import Pose
from phyagentos.runtime.motion.chain import build_chain
from phyagentos.runtime.motion.kinematics import POLISHED, REACHED
from phyagentos.runtime.motion.moves import CHECK_M, leaves_contact, thin_out
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.planning_scene import PlanningScenes
from phyagentos.runtime.motion.requests import (
    Approaches,
    FindGrasps,
    FindLine,
    FindPlacements,
    Motion,
    NoPlan,
    Payload,
    PlanMove,
    TimeLine,
    World,
)
from phyagentos.runtime.motion.sphere_model import SphereModel
from phyagentos.runtime.motion.timing import JointLimits, compute_excess
from tests.runtime.motion.conftest import (
    TABLE,
    WALL,
    build_box,
    build_cube,
    build_fixed,
    build_scene,
    build_tray,
    get_entity,
    replace_entity,
)

pytestmark = pytest.mark.motion

HELD = Payload("cube0", Pose(quaternion_wxyz=(0.0, 1.0, 0.0, 0.0)))


def pick_and_place(planner, find, world, name, q_rad, seed):
    """The motions into a tray (start, motion, payload or None), the world after them, and where the arm ends."""
    grasps = find(FindGrasps(world=world, object=name, q_rad=q_rad, seed=seed))
    goals = np.array([grasp.line_rad[0] for grasp in grasps])
    to_object = planner.answer(PlanMove(world=world, q_rad=q_rad, goals_rad=goals, seed=seed))
    grasp = grasps[to_object.goal]
    entity = get_entity(world, name)
    payload = Payload(name, compute_pose(compute_inverse(compute_matrix(grasp.tcp_end)) @ compute_matrix(entity.pose)))
    q = grasp.line_rad[0]
    places = find(FindPlacements(world=world, payload=payload, destination="tray", q_rad=q, seed=seed))
    goals = np.array([place.line_rad[0] for place in places])
    to_place = planner.answer(PlanMove(world=world, q_rad=q, goals_rad=goals, seed=seed, payload=payload))
    place = places[to_place.goal]
    lines = [line for there in (grasp, place) for line in (there.line_rad, there.line_rad[::-1])]
    motions = [(line[0], planner.answer(TimeLine(waypoints_rad=line)), None) for line in lines]
    moved = msgspec.structs.replace(entity, pose=place.site)
    return [(q_rad, to_object, None), (q, to_place, payload), *motions], replace_entity(world, moved), place.line_rad[0]


@pytest.mark.parametrize("seed", range(10))
def test_a_pick_and_place_is_found_stays_within_the_limits_and_touches_nothing(planner, find, home, seed):
    world = build_scene(seed)
    motions, _, _ = pick_and_place(planner, find, world, "cube0", home, seed)

    limits = JointLimits.from_profile(planner.robot.profile)
    for start, motion, _ in motions:
        trajectory = motion.trajectory
        assert compute_excess(start, trajectory.q_rad, trajectory.qd_rad_s, limits) < 1.0
        assert len(trajectory.q_rad) % limits.steps_per_command == 0
        assert not trajectory.qd_rad_s[-1].any()
    for start, motion, payload in motions[:2]:
        scene = PlanningScenes(planner.robot).get_scene(world, payload)
        assert scene.find_first_blocked(np.vstack((start, motion.trajectory.q_rad))) is None


def draw_motion(home, seed, fastest_rad):
    """A smooth walk (500, 7) from a home posture."""
    turns = np.random.default_rng(seed).uniform(-fastest_rad, fastest_rad, (500, 7))
    return home + np.cumsum(np.cumsum(turns, axis=0) / 20.0, axis=0)


@pytest.mark.parametrize("fastest_rad", [1e-5, 4e-4, 0.004])
def test_between_the_rows_that_are_checked_no_point_of_the_robot_moves_far(planner, home, fastest_rad):
    scene = PlanningScenes(planner.robot).get_scene(build_scene(0))
    arrays = SphereModel(planner.robot, build_chain(planner.robot)).build_arrays(scene)
    rows = draw_motion(home, 1, fastest_rad)

    checked = thin_out(rows, arrays)

    model, corners = planner.robot.model, np.array(list(product((-1.0, 1.0), repeat=3)))
    data, boxes = mujoco.MjData(model), model.geom_aabb
    local = boxes[:, None, :3] + corners * boxes[:, None, 3:]  # of each solid
    places = []
    for q in rows:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        places.append(local @ data.geom_xmat.reshape(-1, 3, 3).transpose(0, 2, 1) + data.geom_xpos[:, None])
    steps_m = np.linalg.norm(np.diff(places, axis=0), axis=3).max(axis=(1, 2))
    at = np.concatenate(((0.0,), steps_m.cumsum()))[[int(np.flatnonzero((rows == q).all(axis=1))[0]) for q in checked]]
    assert np.diff(at).max() <= max(CHECK_M, steps_m.max()) + 1e-12
    assert np.array_equal(checked[[0, -1]], rows[[0, -1]])
    assert len(checked) < 100 or fastest_rad > 1e-4
    assert np.array_equal(thin_out(rows[:1], arrays), rows[:1])


def test_rows_that_a_margin_covers_are_judged_as_when_each_is_checked(planner, home):
    robot = planner.robot
    scene = PlanningScenes(robot).get_scene(build_scene(0))
    arrays = SphereModel(robot, build_chain(robot)).build_arrays(scene)
    goals = np.random.default_rng(0).uniform(robot.q_min_rad, robot.q_max_rad, (40, len(home)))
    motions = [thin_out(home + np.linspace(0.0, 1.0, 2000)[:, None] * (goal - home), arrays) for goal in goals]

    each = [scene.find_first_blocked(rows) for rows in motions]
    alone = scene.checks

    assert [scene.find_first_blocked(rows, CHECK_M) for rows in motions] == each
    assert scene.checks - alone < alone / 2
    assert 10 < sum(found is not None for found in each) < 35


def test_three_cubes_find_room_in_one_tray_one_after_the_other(planner, find, home):
    world, q = build_scene(3), home
    for cube in ("cube0", "cube1", "cube2"):
        _, world, q = pick_and_place(planner, find, world, cube, q, 3)

    tray = get_entity(world, "tray")
    placed = [get_entity(world, cube).pose.position_m for cube in ("cube0", "cube1", "cube2")]
    for x, y, z in placed:
        assert abs(x - tray.pose.position_m[0]) < 0.075
        assert abs(y - tray.pose.position_m[1]) < 0.075
        assert z == pytest.approx(0.025, abs=1e-6)


def test_the_same_request_gives_the_same_bits_in_any_order_and_in_a_fresh_planner(planner, home, profile_file):
    first, second = (FindGrasps(world=build_scene(s), object="cube1", q_rad=home, seed=s) for s in (5, 6))
    goals = home + np.array(((0.9, 0.3, 0.0, 0.2, 0.0, 0.4, 0.0), (1.2, 0.6, 0.0, 0.3, 0.0, 0.4, 0.0)))
    move = PlanMove(world=build_scene(7), q_rad=home, goals_rad=goals, seed=7)
    requests = [first, second, move]

    forward = [planner.answer(request) for request in requests]
    backward = [planner.answer(request) for request in reversed(requests)]
    fresh = [type(planner).open(profile_file).answer(request) for request in requests]

    assert isinstance(forward[2], Motion)
    for a, b, c in zip(forward, reversed(backward), fresh, strict=True):
        assert encode(a) == encode(b) == encode(c)


def encode(answer):
    if isinstance(answer, Approaches):
        ways = [(approach.label, approach.tcp_end, approach.line_rad.tobytes()) for approach in answer.approaches]
        return ways, answer.stages
    return answer.goal, answer.trajectory.q_rad.tobytes(), answer.trajectory.qd_rad_s.tobytes(), answer.stages


def test_every_goal_posture_is_polished_and_one_of_a_line_takes_hardly_more_than_one_program(planner, home):
    rows, steps = 0, 0
    for seed in range(6):
        found = planner.answer(FindGrasps(world=build_scene(seed), object="cube0", q_rad=home, seed=seed))
        stages = found.stages

        assert [goal.label for goal in stages.goals] == [approach.label for approach in found.approaches]
        assert 0 < stages.screening.reached <= stages.screening.solved
        for goal, approach in zip(stages.goals, found.approaches, strict=True):
            assert goal.hover.iterations > 0
            assert goal.hover.position_error_m < POLISHED.position_m < REACHED.position_m
            assert goal.hover.rotation_error_rad < POLISHED.rotation_rad < REACHED.rotation_rad
            assert goal.line.iterations >= len(approach.line_rad) - 1
            tip = planner._chain.compute_tcp(approach.line_rad[0])[:3, 3]
            assert tip == pytest.approx(np.add(approach.tcp_end.position_m, (0.0, 0.0, 0.08)), abs=2e-7)
            rows += len(approach.line_rad) - 1
            steps += goal.line.iterations

    assert rows <= steps < 1.2 * rows


def test_another_seed_may_go_another_way(planner, home):
    goals = (home + np.array((0.9, 0.5, 0.0, 0.0, 0.0, 0.5, 0.0)))[None]
    start = home + np.array((-0.9, 0.5, 0.0, 0.0, 0.0, 0.5, 0.0))
    motions = [
        planner.answer(PlanMove(world=World((WALL,)), q_rad=start, goals_rad=goals, seed=seed)) for seed in (1, 2)
    ]

    assert [motion.stages.path.planner for motion in motions] == ["OMPL RRT-Connect"] * 2
    assert all(motion.stages.path.iterations > 0 for motion in motions)
    assert motions[0].trajectory.q_rad.tobytes() != motions[1].trajectory.q_rad.tobytes()


def test_an_answer_counts_what_it_called_of_each_library(planner, home):
    found = planner.answer(FindGrasps(world=build_scene(1), object="cube0", q_rad=home, seed=1))
    direct = planner.answer(PlanMove(world=World(()), q_rad=home, goals_rad=home[None] + 0.4, seed=1))
    left, right = (home + np.array((turn, 0.5, 0.0, 0.0, 0.0, 0.5, 0.0)) for turn in (-0.9, 0.9))
    around = planner.answer(PlanMove(world=World((WALL,)), q_rad=left, goals_rad=right[None], seed=1))

    assert found.stages.calls.keys() == {"mink"}
    assert found.stages.calls["mink"] >= sum(
        goal.hover.iterations + goal.line.iterations for goal in found.stages.goals
    )
    assert direct.stages.calls == {"toppra": 1}
    assert around.stages.calls["ompl"] == 4


def test_half_the_speed_of_a_request_or_of_the_planner_takes_about_twice_as_long(planner, profile_file, home):
    request = PlanMove(world=World(()), q_rad=home, goals_rad=home[None] + 0.4, seed=1)
    full, half = (planner.answer(msgspec.structs.replace(request, speed=speed)) for speed in (1.0, 0.5))
    slow = MotionPlanner.open(profile_file, speed=0.5).answer(request)

    assert len(half.trajectory.q_rad) / len(full.trajectory.q_rad) == pytest.approx(2.0, rel=0.05)
    assert np.array_equal(slow.trajectory.q_rad, half.trajectory.q_rad)


def test_an_arm_that_is_there_already_holds_for_one_period(planner, home):
    motion = planner.answer(PlanMove(world=World(()), q_rad=home, goals_rad=home[None], seed=1))

    assert np.array_equal(motion.trajectory.q_rad, np.repeat(home[None], 10, axis=0))
    assert not motion.trajectory.qd_rad_s.any()


def test_goals_inside_a_wall_are_refused_with_the_pair_that_touches(planner, home):
    x, y, z = planner._chain.compute_tcp(home)[:3, 3]
    wall = build_fixed("wall", (x, y + 0.3, z), build_box((0, 0, 0), (0.3, 0.05, 0.3)))
    goal = home + np.array((0.6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    answer = planner.answer(PlanMove(world=World((wall,)), q_rad=home, goals_rad=goal[None], seed=1))

    assert isinstance(answer, NoPlan)
    assert answer.code == "IN_COLLISION"
    assert all(reason.endswith("|wall") for reason in answer.rejected)
    assert "goal postures" in answer.message


def test_an_arm_in_contact_leaves_it_once_and_never_touches_it_again(planner, home):
    x, y, z = planner._chain.compute_tcp(home)[:3, 3]
    world = World((build_cube("stone", x, y + 0.03, half=0.02, z=float(z)),))
    goal = home + np.array((-0.6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    motion = planner.answer(PlanMove(world=world, q_rad=home, goals_rad=goal[None], seed=1))

    scene = PlanningScenes(planner.robot).get_scene(world, None)
    touched = scene.find_contacts(home)
    rows = np.vstack((home, motion.trajectory.q_rad))
    assert any("stone" in pair for pair in touched)
    assert leaves_contact(rows, touched, scene)
    assert not leaves_contact(np.vstack((rows, rows[::-1])), touched, scene)
    assert not leaves_contact(rows, [], scene)


def test_an_arm_that_is_boxed_in_is_told_so_and_may_ignore_the_entity(planner, home):
    x, y, z = planner._chain.compute_tcp(home)[:3, 3]
    world = World((build_cube("stone", x, y, half=0.25, z=float(z)),))
    request = PlanMove(world=world, q_rad=home, goals_rad=home[None] + 0.1, seed=1)
    answer = planner.answer(request)
    ignoring = planner.answer(msgspec.structs.replace(request, ignore=("stone",)))

    assert answer.code == "IN_COLLISION"
    assert "finds no way out" in answer.message
    assert isinstance(ignoring, Motion)


def test_an_unknown_entity_is_answered_with_the_nearest_name(planner, home):
    answer = planner.answer(FindGrasps(world=build_scene(0), object="cube9", q_rad=home, seed=1))

    assert answer.code == "OBJECT_GONE"
    assert "Did you mean 'cube" in answer.message


@pytest.fixture
def impossible(home):
    """A move from one side of a high wall to the other, whose gap for the arm's column is too small for its elbow."""
    world = World(
        (
            build_fixed("front", (1.2, 0.0, 1.0), build_box((0, 0, 0), (1.0, 0.01, 1.0))),
            build_fixed("back", (-1.2, 0.0, 1.0), build_box((0, 0, 0), (1.0, 0.01, 1.0))),
            build_fixed("lid", (0.0, 0.0, 1.3), build_box((0, 0, 0), (0.2, 0.01, 0.75))),
        )
    )
    start, goal = (home + np.array((turn, 1.4, 0.0, 0.0, 0.0, 0.5, 0.0)) for turn in (1.5, -1.5))
    return PlanMove(world=world, q_rad=start, goals_rad=goal[None], seed=1)


def test_a_search_without_a_way_can_be_cancelled(planner, impossible):
    calls = 0

    def cancel_later():
        nonlocal calls
        calls += 1
        return calls > 200

    assert planner.answer(impossible, cancel_later).code == "CANCELLED"
    assert calls < 210


def test_a_search_without_a_way_ends_with_its_budget(planner, impossible, monkeypatch):
    monkeypatch.setattr("phyagentos.runtime.motion.moves.ITERATIONS", 300)
    answer = planner.answer(impossible)

    assert answer.code == "NO_PLAN"
    assert "No path to any of 1 goals" in answer.message


def test_a_grasp_label_that_is_avoided_is_not_offered_again(planner, home):
    world = World((build_cube("cube", 0.5, 0.0, 0.3),))
    request = FindGrasps(world=world, object="cube", q_rad=home, seed=1, count=8)
    offered = {approach.label for approach in planner.answer(request).approaches}
    nearest = planner.answer(request).approaches[0].label
    again = planner.answer(msgspec.structs.replace(request, avoid=(nearest,)))

    assert offered <= {"yaw+000", "yaw+090", "yaw+180", "yaw+270"}
    assert nearest not in {approach.label for approach in again.approaches}


def test_a_full_tray_has_no_free_site_and_a_far_one_is_out_of_reach(planner, home):
    near, far = build_tray("near", 0.5, 0.2, 0.035, 0.035), build_tray("far", 1.5, 0.2)
    world = World((near, far, build_cube("cube0", 0.4, -0.2), build_cube("other", 0.5, 0.2)))
    full = planner.answer(FindPlacements(world=world, payload=HELD, destination="near", q_rad=home, seed=1))
    distant = planner.answer(FindPlacements(world=world, payload=HELD, destination="far", q_rad=home, seed=1))

    assert (full.code, distant.code) == ("NO_FREE_SITE", "NO_IK")
    assert full.rejected["occupied"] > 0
    assert distant.rejected["ik"] > 0


def test_a_cube_is_put_on_another_and_near_a_point(planner, home):
    world = World((build_tray("tray", 0.5, 0.3), build_cube("cube0", 0.4, -0.2), build_cube("base", 0.5, 0.0)))
    on = FindPlacements(world=world, payload=HELD, destination="base", relation="on", q_rad=home, seed=1)
    point = (0.53, 0.33, 0.02)
    near = FindPlacements(world=world, payload=HELD, destination="tray", q_rad=home, seed=1, near=point)

    assert planner.answer(on).approaches[0].site.position_m == pytest.approx((0.5, 0.0, 0.06), abs=1e-6)
    site = planner.answer(near).approaches[0].site.position_m
    assert np.linalg.norm(np.array(site)[:2] - point[:2]) < 0.03


def test_objects_are_put_into_a_region_on_the_table(planner, home):
    answer = planner.answer(
        FindPlacements(world=build_scene(0), payload=HELD, destination="front_right", q_rad=home, seed=0)
    )

    x, y, z = answer.approaches[0].site.position_m
    assert abs(x - 0.4) < 0.1
    assert abs(y + 0.42) < 0.06
    assert z == pytest.approx(0.02, abs=1e-6)


def test_a_lift_may_begin_in_contact_but_not_run_into_another_object(planner, home):
    world = build_scene(0)
    grasp = planner.answer(FindGrasps(world=world, object="cube0", q_rad=home, seed=0)).approaches[0]
    q = grasp.line_rad[-1]
    x, y, z = grasp.tcp_end.position_m
    up, aside = (Pose((x, y + dy, z + 0.05), grasp.tcp_end.quaternion_wxyz) for dy in (0.0, -0.1))
    pillar = build_fixed("pillar", (x, y - 0.17, z + 0.1), build_box((0, 0, 0), (0.02, 0.02, 0.2)))
    lift = FindLine(world=world, q_rad=q, waypoints=(up,), seed=0, payload=HELD)
    blocked = msgspec.structs.replace(lift, waypoints=(up, aside), world=World((*world.entities, pillar)))

    line = planner.answer(lift).approaches[0].line_rad
    assert planner._chain.compute_tcp(line[-1])[2, 3] == pytest.approx(z + 0.05, abs=2e-4)
    assert planner.answer(blocked).code == "IN_COLLISION"
    assert any(reason.endswith("|pillar") for reason in planner.answer(blocked).rejected)


@pytest.mark.parametrize(("half_m", "yaw_rad"), [(0.01, 0.6), (0.0125, 0.0), (0.015, 0.6), (0.02, 0.0)])
def test_fingers_around_a_small_object_and_on_their_way_open_touch_no_wall_of_a_tray(
    planner, find, home, half_m, yaw_rad
):
    """A wall between a finger that holds and the same finger opened is in its way, though both are beside it."""
    turned = Pose((0.5, 0.3, 0.0), convert_euler((0.0, 0.0, yaw_rad)))
    tray = msgspec.structs.replace(build_tray("tray", 0.5, 0.3, 0.05, 0.06), pose=turned)
    world = World((TABLE, tray, build_cube("cube0", 0.4, -0.2, half=half_m)))
    held = Payload("cube0", Pose((0.0, 0.0, 0.0)), width_m=2.0 * half_m)
    bare = PlanningScenes(planner.robot).get_scene(World((TABLE, tray)))
    for approach in find(FindPlacements(world=world, payload=held, destination="tray", q_rad=home, seed=1)):
        for opening_m in np.linspace(held.width_m, approach.release_m, 20):
            bare.spread_fingers(opening_m, opening_m)
            assert bare.find_contacts(approach.line_rad[-1]) == [], (approach.label, opening_m)
