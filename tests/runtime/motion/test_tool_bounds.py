"""Plans keep the tool centre point inside the workspace and out of the keep-out boxes that safety.yaml gives."""

import mujoco
import numpy as np
import pytest

from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.settings.safety import read_safety
from phyagentos.protocol.world.environment import Pose
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.requests import FindGrasps, FindLine, FindPlacements, Motion, Payload, PlanMove
from phyagentos.runtime.motion.tool_bounds import read_tool_bounds
from tests.runtime.motion.conftest import build_cube, build_scene, get_entity

pytestmark = pytest.mark.motion

LIMITS = read_safety(find_shipped_root() / "protocol/safety.yaml").targets["panda"]
COLUMN = ((0.3, -0.04, -0.02), (0.8, 0.04, 0.7))  # between the cubes


@pytest.fixture(scope="module")
def bounded(profile_file):
    return MotionPlanner.open(profile_file, bounds=read_tool_bounds(LIMITS) | {"keep_out.column": COLUMN})


def measure_tools(planner, rows_rad):
    """(n, 3) of the tool centre point, by MuJoCo."""
    model = planner.robot.model
    data, site = mujoco.MjData(model), model.site(planner.robot.profile.tcp).id
    tools = []
    for q in rows_rad:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        tools.append(data.site_xpos[site].copy())
    return np.array(tools)


def is_in_column(planner, answer):
    assert isinstance(answer, Motion)
    tools = measure_tools(planner, answer.trajectory.q_rad)
    return bool(((tools > COLUMN[0]) & (tools < COLUMN[1])).all(axis=1).any())


def make_world(x=0.5, y=0.25):
    scene = build_scene(0, cubes=0)
    table = get_entity(scene, "table")
    return type(scene)((table, build_cube("left", 0.5, 0.25), build_cube("right", 0.5, -0.25), build_cube("far", x, y)))


def test_a_motion_goes_around_what_the_tool_is_to_keep_out_of(planner, bounded, home):
    world = make_world(0.3, 0.4)
    hovers = [
        bounded.answer(FindGrasps(world=world, object=name, q_rad=home, seed=0)).approaches[0].line_rad[0]
        for name in ("left", "right")
    ]
    request = PlanMove(world=world, q_rad=hovers[0], goals_rad=hovers[1][None], seed=0)

    assert is_in_column(planner, planner.answer(request))
    assert not is_in_column(bounded, bounded.answer(request))


def test_a_line_that_would_leave_the_bounds_is_refused_with_what_bounds_it(bounded, home):
    world = make_world(0.3, 0.4)
    grasp = bounded.answer(FindGrasps(world=world, object="left", q_rad=home, seed=0)).approaches[0]
    tool = bounded._chain.compute_tcp(grasp.line_rad[0])
    x, y, z = tool[:3, 3]
    end = type(grasp.tcp_end)((x, y - 0.3, z), grasp.tcp_end.quaternion_wxyz)

    answer = bounded.answer(FindLine(world=world, q_rad=grasp.line_rad[0], waypoints=(end,), seed=0))

    assert answer.rejected == {"hand|keep_out.column": 1}


def test_what_can_only_be_grasped_beyond_the_bounds_is_refused_for_that(profile_file, home):
    narrow = MotionPlanner.open(profile_file, bounds={"workspace_box": ((-0.3, -0.4, -0.02), (0.9, 0.36, 1.3))})

    answer = narrow.answer(FindGrasps(world=make_world(0.4, 0.4), object="far", q_rad=home, seed=0))

    assert max(answer.rejected, key=lambda reason: answer.rejected[reason]) == "hand|workspace_box"


def test_a_place_that_the_tool_is_to_keep_out_of_is_refused_without_any_inverse_kinematics(profile_file, home):
    scene = build_scene(0)
    x, y, z = get_entity(scene, "tray").pose.position_m
    kept_out = {"keep_out.tray": ((x - 0.2, y - 0.25, z - 0.1), (x + 0.2, y + 0.25, z + 0.5))}
    narrow = MotionPlanner.open(profile_file, bounds=kept_out)
    held = Payload("cube0", Pose(), 0.04)

    answer = narrow.answer(FindPlacements(world=scene, payload=held, destination="tray", q_rad=home, seed=0))

    assert set(answer.rejected) <= {"hand|keep_out.tray", "occupied"}
    assert answer.stages.screening is None
