"""Another robot in the planner's world: where it stands, where it has announced to pass, and what it holds."""

import msgspec
import mujoco
import numpy as np
import pytest

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.placed_scenes import read_placed
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.drivers.mujoco.inter_robot_collisions import CLEARANCE_M
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.models.world import compile_scene
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.requests import Motion, Neighbour, PlanMove, World
from tests.runtime.motion.conftest import build_cube
from tests.runtime.targets.test_shared_world import ARMS, EXAMPLE

pytestmark = pytest.mark.motion

HOME = np.array((0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785))


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return Workspace.create(tmp_path_factory.mktemp("w"), Library.open(EXAMPLE)).library()


@pytest.fixture(scope="module")
def planner(library):
    left, right = map(library.get_target, ARMS)
    return MotionPlanner.open(left, neighbours={"right_arm": right})


@pytest.fixture(scope="module")
def measure(library):
    """How near the arms come in two postures, by the simulated model [m]."""
    robots = [read_profile(library.get_target(name)) for name in ARMS]
    model = compile_scene(robots, read_placed(library, "two_arms"), 0).model
    data = mujoco.MjData(model)
    solid = [g for g in range(model.ngeom) if model.geom_contype[g]]
    sides = [[g for g in solid if model.body(model.geom_bodyid[g]).name.startswith(arm)] for arm in ARMS]
    address = [[int(model.joint(f"{arm}/joint{k}").qposadr[0]) for k in range(1, 8)] for arm in ARMS]

    def nearest(left, right):
        data.qpos[address[0]], data.qpos[address[1]] = left, right
        mujoco.mj_kinematics(model, data)
        return min(mujoco.mj_geomDistance(model, data, a, b, 0.1, None) for a in sides[0] for b in sides[1])

    return nearest


def turn(turn_rad, lean_rad=0.5):
    return HOME + np.array((turn_rad, lean_rad, 0.0, 0.0, 0.0, 0.0, 0.0))


def ask(planner, start, goal, *postures, entities=(), ignore=("beam",), **settings):
    neighbours = (Neighbour("right_arm", np.array(postures), **settings),) if postures else ()
    return planner.answer(PlanMove(World(entities, (), neighbours), start, 1, goal[None], ignore=ignore))


def find_nearest(answer, measure, postures):
    return min(measure(q, other) for q in answer.trajectory.q_rad[::20] for other in postures)


def test_a_move_goes_around_the_posture_and_the_announced_way_of_another_robot(planner, measure):
    start = np.array((-0.85, -0.4, -0.47, -2.33, 0.01, 1.14, 0.79))
    goal = np.array((-0.17, 0.13, 0.06, -1.89, 0.0, 2.06, 0.79))
    way = [turn(each, 0.1) for each in np.linspace(0.2, 0.9, 15)]
    blind, seeing = ask(planner, start, goal), ask(planner, start, goal, *way)

    assert isinstance(seeing, Motion), seeing
    assert find_nearest(blind, measure, way) < CLEARANCE_M < find_nearest(seeing, measure, way)


def test_where_no_way_is_left_the_answer_names_the_robot(planner):
    answer = ask(planner, turn(0.3), turn(-1.0), turn(1.0))

    assert answer.neighbours == ("right_arm",)


def test_what_another_robot_holds_is_in_the_way_unless_the_hand_comes_for_it(planner):
    start, goal, other = turn(0.6), turn(-0.4), turn(0.2, 0.3)
    tip = planner._chain.compute_tcp(goal)[:3, 3]
    beam = build_cube("beam", *tip[:2], half=0.03, z=float(tip[2]))  # which only the other robot's grip reaches
    beam = msgspec.structs.replace(beam, held_by="right_arm")
    alone = ask(planner, start, goal, other)
    held = ask(planner, start, goal, other, entities=(beam,))
    handed = ask(planner, start, goal, other, entities=(beam,), is_met=True)

    assert isinstance(alone, Motion), alone
    assert held.neighbours == ("right_arm",)
    assert isinstance(handed, Motion), handed
