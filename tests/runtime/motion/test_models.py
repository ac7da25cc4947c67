"""The robot's models: chain, spheres, scenes, shapes; they agree with MuJoCo and with each other."""

from itertools import pairwise

import msgspec
import mujoco
import numpy as np
import pytest

from phyagentos.errors import DefinitionError
from phyagentos.geometry import compute_matrix, compute_rotation_vector
from phyagentos.protocol.world.entity_geometry import compute_extent
from phyagentos.protocol.world.environment import UNNAMED, Entity, Pose, Shape, ShapeKind
from phyagentos.runtime.motion.kinematics import POLISHED, REACHED
from phyagentos.runtime.motion.planning_scene import PlanningScenes
from phyagentos.runtime.motion.poses import interpolate_poses, point_tool_down
from phyagentos.runtime.motion.requests import Motion, Payload, PlanMove, World
from phyagentos.runtime.motion.robot_model import build_robot_model
from phyagentos.runtime.motion.shapes import compute_bounds
from phyagentos.runtime.motion.solids import add_geoms
from phyagentos.runtime.motion.sphere_checker import SphereChecker
from tests.runtime.motion.conftest import WALL, build_box, build_cube, build_fixed, build_scene

pytestmark = pytest.mark.motion


def draw_postures(planner, count, seed=0):
    robot = planner.robot
    return np.random.default_rng(seed).uniform(robot.q_min_rad, robot.q_max_rad, (count, len(robot.q_min_rad)))


def test_the_chain_agrees_with_mujoco(planner):
    data = mujoco.MjData(planner.robot.model)
    for q in draw_postures(planner, 20):
        data.qpos[:] = q
        mujoco.mj_kinematics(planner.robot.model, data)
        T = planner._chain.compute_tcp(q)

        assert T[:3, 3] == pytest.approx(data.site("tcp").xpos, abs=1e-9)
        assert T[:3, :3].reshape(9) == pytest.approx(data.site("tcp").xmat, abs=1e-9)


def test_screening_and_polishing_reach_a_pose_within_their_tolerances(planner, home):
    target = point_tool_down(0.4, np.array((0.5, 0.1, 0.2)))
    screened = planner._chain.solve(target, home)
    solved = planner._kinematics.solve(target, home)
    polished = planner._kinematics.solve(target, screened, POLISHED)

    for q, tolerance in ((screened, REACHED), (solved.q_rad, REACHED), (polished.q_rad, POLISHED)):
        reached = planner._chain.compute_tcp(q)
        assert np.linalg.norm(reached[:3, 3] - target[:3, 3]) < 1.1 * tolerance.position_m
        assert (
            np.linalg.norm(compute_rotation_vector(reached[:3, :3].T @ target[:3, :3])) < 1.1 * tolerance.rotation_rad
        )


def test_quadratic_programs_solve_what_the_compiled_inverse_does_not_between_the_limits_of_joints(planner):
    chain, rng, stalled = planner._chain, np.random.default_rng(0), 0
    for _ in range(40):
        q = rng.uniform(chain.q_min_rad, chain.q_max_rad)
        q[:3] = chain.q_min_rad[:3]
        target, start = chain.compute_tcp(q), np.maximum(q + rng.normal(0.0, 0.1, len(q)), chain.q_min_rad)
        polished = planner._kinematics.solve(target, start, POLISHED)
        stalled += chain.solve(target, start) is None and polished is not None
        if polished is not None:
            assert chain.compute_tcp(polished.q_rad) == pytest.approx(target, abs=2e-6)
            assert np.all(polished.q_rad > chain.q_min_rad - 1e-5)

    assert stalled > 0


def test_a_line_of_the_tool_is_straight_and_one_out_of_reach_is_none(planner, home):
    start = planner._chain.compute_tcp(home)
    down, away = start.copy(), start.copy()
    down[2, 3] -= 0.2
    away[0, 3] += 1.0
    line = planner._kinematics.solve_line(home, down).q_rad
    tips = planner._chain.compute_tcp_path(line)[:, :3, 3]

    assert len(line) == 21
    assert np.abs(tips[:, :2] - start[:2, 3]).max() < 1.5e-4
    assert planner._kinematics.solve_line(home, away) is None


def test_a_line_that_stops_at_the_end_of_a_joint_and_swings_beyond_it_is_none(planner):
    """The guard refused it on the way: joint 7 at 2.8876 rad, and 2.8873 is allowed."""
    start = np.array((1.3248, -0.0602, 0.5174, -2.9028, 0.1034, 2.8489, 2.1676))
    end = compute_matrix(Pose((-0.0825, 0.3327, 0.0183), (0.0, 0.9838, 0.1791, 0.0)))
    assert planner._kinematics.solve_line(start, end) is None


@pytest.mark.parametrize("payload", [None, Payload("cube0", Pose((0.0, 0.0, 0.0)))])
def test_spheres_call_nothing_free_that_touches_the_world(planner, payload):
    scene = PlanningScenes(planner.robot).get_scene(build_scene(1), payload)
    checker = SphereChecker(planner._spheres.build_arrays(scene))
    exact, spheres = (
        np.array([check(q) for q in draw_postures(planner, 2000)]) for check in (scene.is_free, checker.is_free)
    )

    assert 0.1 < exact.mean() < 0.9
    assert (spheres & ~exact).sum() <= 0.005 * spheres.sum()
    assert (exact & ~spheres).sum() <= 0.06 * exact.sum()


def test_an_edge_through_a_wall_is_blocked_for_both_checkers(planner, home):
    scene = PlanningScenes(planner.robot).get_scene(World((WALL,)))
    checker = SphereChecker(planner._spheres.build_arrays(scene))
    left, right = (home + np.array((turn, 0.5, 0.0, 0.0, 0.0, 0.5, 0.0)) for turn in (0.9, -0.9))

    for check in (scene, checker):
        assert check.is_free(left)
        assert check.is_free(right)
        assert not check.edge_is_free(left, right)
        assert not check.path_is_free(np.array((left, right)))


def test_a_motion_goes_around_an_object_that_has_no_name(planner, home):
    box = msgspec.structs.replace(
        build_cube("unknown_1", 0.55, 0.0), kind=UNNAMED, shapes=(build_box((0, 0, 0.33), (0.04, 0.04, 0.35)),)
    )
    start, goal = (home + np.array((turn, 0.5, 0.0, 0.0, 0.0, 0.5, 0.0)) for turn in (-0.9, 0.9))
    scenes = PlanningScenes(planner.robot)
    assert scenes.get_scene(World(())).edge_is_free(start, goal)
    scene = scenes.get_scene(World((box,)))
    assert not scene.edge_is_free(start, goal)
    motion = planner.answer(PlanMove(world=World((box,)), q_rad=start, goals_rad=goal[None], seed=1))
    assert isinstance(motion, Motion), motion
    assert all(scene.is_free(q) for q in motion.trajectory.q_rad)


def test_a_new_pose_needs_no_new_model_and_a_held_object_is_no_obstacle(planner, home):
    tip = planner._chain.compute_tcp(home)[:3, 3]
    near, far = (World((build_cube("cube", *tip[:2], half=0.05, z=float(z)),)) for z in (tip[2], 0.02))
    scenes = PlanningScenes(planner.robot)

    assert {pair[1] for pair in scenes.get_scene(near).find_contacts(home)} == {"cube"}
    assert scenes.get_scene(far).find_contacts(home) == []
    assert scenes.get_scene(near) is scenes.get_scene(far)
    assert scenes.get_scene(near, Payload("cube", Pose())).find_contacts(home) == []


def draw_place(rng, along_m):
    quaternion = rng.normal(size=4)
    return Pose(
        (0.0, along_m, float(rng.uniform(-0.1, 0.1))), tuple(map(float, quaternion / np.linalg.norm(quaternion)))
    )


def draw_world(rng):
    """Solids of every kind, tilted, about the arm; the same names at every call, other sizes and places."""
    kinds = {ShapeKind.BOX: 3, ShapeKind.CYLINDER: 2, ShapeKind.CAPSULE: 2, ShapeKind.SPHERE: 1}
    entities = []
    for kind, sizes in kinds.items():
        for movable in (True, False):
            shapes = [
                Shape(kind, tuple(map(float, rng.uniform(0.02, 0.12, sizes))), draw_place(rng, 0.15 * part))
                for part in range(3)
            ]
            x, y, z = map(float, rng.uniform((-0.7, -0.7, 0.0), (0.7, 0.7, 0.8)))
            quaternion = rng.normal(size=4)
            quaternion /= np.linalg.norm(quaternion)
            name = f"{kind.value}_{'movable' if movable else 'fixed'}"
            pose = Pose((x, y, z), tuple(map(float, quaternion)))
            entities.append(Entity(name=name, kind=name, pose=pose, movable=movable, shapes=tuple(shapes)))
    return World(tuple(entities))


def test_an_edge_in_spheres_is_free_exactly_where_each_of_its_postures_is(planner):
    rng = np.random.default_rng(0)
    found = []
    for _ in range(8):
        scene = PlanningScenes(planner.robot).get_scene(draw_world(rng))
        checker = SphereChecker(planner._spheres.build_arrays(scene))
        for start, end in draw_postures(planner, 100).reshape(50, 2, -1):
            end = start + (end - start) * rng.random()  # from the shortest to the longest edges
            postures = start + (end - start) * np.linspace(0.0, 1.0, 65)[1:, None]
            found.append(checker.edge_is_free(start, end, np.linalg.norm(end - start) / 63.5))
            assert found[-1] == all(checker.is_free(q) for q in postures)

    assert 0.05 < np.mean(found) < 0.9


def compile_reference(planner, world):
    """The same world in a model made for it, where what the robot stands on is excluded by name."""
    spec, robot = planner.robot.spec.copy(), planner.robot
    for entity in world.entities:
        body = spec.worldbody.add_body(
            name=entity.name, pos=entity.pose.position_m, quat=entity.pose.quaternion_wxyz, mocap=True
        )
        margin_m = 0.002 if entity.movable else 0.004
        solids = [
            msgspec.structs.replace(shape, size_m=tuple(part + margin_m for part in shape.size_m))
            for shape in entity.shapes
        ]
        add_geoms(body, solids, 2, 0)
        for part in () if entity.movable else robot.mounting:
            spec.add_exclude(bodyname1=part, bodyname2=entity.name)
    return spec.compile()


def list_contacts(model, data, q):
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    mujoco.mj_collision(model, data)
    bodies = [tuple(model.body(int(model.geom_bodyid[geom])).name for geom in pair) for pair in data.contact.geom]
    return sorted({(b, a) if a.endswith(("_movable", "_fixed")) else (a, b) for a, b in bodies})


@pytest.mark.parametrize("held", [None, "box_movable", "cylinder_movable"])
def test_new_sizes_and_places_need_no_new_model_and_collide_as_a_model_made_for_them(planner, held):
    rng = np.random.default_rng(3)
    payload = None if held is None else Payload(held, Pose((0.0, 0.0, 0.08)))
    kept = PlanningScenes(planner.robot)
    first = kept.get_scene(draw_world(rng), payload)
    met = set()
    for world in (draw_world(rng) for _ in range(4)):
        fresh = PlanningScenes(planner.robot).get_scene(world, payload)
        reference = compile_reference(planner, world)
        data = mujoco.MjData(reference)
        assert kept.get_scene(world, payload) is first
        assert first.payload_shapes == fresh.payload_shapes
        for q in draw_postures(planner, 80):
            touching = first.find_contacts(q)
            assert touching == fresh.find_contacts(q)
            if held is None:
                assert touching == list_contacts(reference, data, q)
            met |= {pair[1] for pair in touching} | {pair[0] for pair in touching}
    assert met >= {entity.name for entity in world.entities} - {held}
    assert ("payload" in met) == (held is not None)


def test_what_is_held_collides_in_the_place_of_the_hand(planner, home):
    tip = planner._chain.compute_tcp(home)[:3, 3]
    shelf = build_fixed("shelf", (tip[0], tip[1], tip[2] - 0.08), build_box((0, 0, 0), (0.1, 0.1, 0.01)))
    world = World((shelf, build_cube("cube", 0.4, 0.3, half=0.03)))
    scenes = PlanningScenes(planner.robot)
    low = Payload("cube", Pose((0.0, 0.0, 0.05)))

    assert scenes.get_scene(world).find_contacts(home) == []
    assert scenes.get_scene(world, low).find_contacts(home) == [("payload", "shelf")]


def test_depth_and_bounds_of_a_lying_cylinder(planner):
    shapes = (Shape(ShapeKind.CYLINDER, (0.03, 0.1), Pose((0.0, 0.0, 0.1))),)
    upright, lying = np.eye(3), compute_matrix(Pose(quaternion_wxyz=(0.5**0.5, 0.5**0.5, 0.0, 0.0)))[:3, :3]
    center, half = compute_bounds(shapes)

    assert center.tolist() == pytest.approx([0.0, 0.0, 0.1])
    assert half.tolist() == pytest.approx([0.03, 0.03, 0.1])
    cylinder = Entity(name="can", kind="can", pose=Pose(), shapes=shapes)
    assert compute_extent(cylinder, tuple(-upright[2])) == pytest.approx((-0.2, 0.0))
    assert compute_extent(cylinder, tuple(-lying[2])) == pytest.approx((-0.03, 0.03))


def test_interpolated_poses_turn_and_move_evenly():
    start, end = point_tool_down(0.0, np.zeros(3)), point_tool_down(1.0, np.array((0.0, 0.0, 0.1)))
    poses = interpolate_poses(start, end, 0.05, 0.1)
    turns = [np.linalg.norm(compute_rotation_vector(a[:3, :3].T @ b[:3, :3])) for a, b in pairwise(poses)]

    assert len(poses) == 11
    assert turns == pytest.approx([0.1] * 10, abs=1e-6)
    assert poses[-1] == pytest.approx(end, abs=1e-9)


def test_a_profile_that_names_an_absent_site_is_refused_with_the_known_ones(planner, profile_file):
    profile = planner.robot.profile.model_copy(update={"tcp": "tpc"})

    with pytest.raises(DefinitionError, match=r"UNKNOWN_NAME \(site\): found 'tpc'.*Did you mean 'tcp'\?"):
        build_robot_model(profile, profile_file.parent)


def test_a_bottle_is_taken_below_its_top_and_a_wide_box_is_too_wide(planner, home):
    from phyagentos.runtime.motion.requests import FindGrasps

    bottle = Entity(
        name="bottle",
        kind="bottle",
        pose=Pose((0.5, 0.0, 0.1)),
        shapes=(Shape(ShapeKind.CYLINDER, (0.025, 0.1)),),
    )
    crate = build_cube("crate", 0.4, 0.3, half=0.06)
    world = World((bottle, crate))
    held = planner.answer(FindGrasps(world=world, object="bottle", q_rad=home, seed=1)).approaches[0]
    refused = planner.answer(FindGrasps(world=world, object="crate", q_rad=home, seed=1))

    assert held.tcp_end.position_m == pytest.approx((0.5, 0.0, 0.18))
    assert refused.code == "NOT_GRASPABLE"
    assert "crate is wider than the gripper opens (0.08 m)" in refused.message


def test_a_line_begins_at_its_start_even_beyond_the_margin_of_a_limit(planner, home):
    chain = planner._chain
    start = home.copy()
    start[5] = chain.q_max_rad[5] + 1e-3
    within = np.minimum(start, chain.q_max_rad)
    poses = np.stack([chain.compute_tcp(start), chain.compute_tcp(within)])
    assert (chain.follow(poses, start)[0] == start).all()
