"""A peg that meets the rim: the motion stops at the force that it is given, and the next try is a little beside it."""

from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from phyagentos.geometry import Pose, compute_pose
from phyagentos.protocol.world.environment import Entity, Interior, Shape, ShapeKind
from phyagentos.runtime.execution.leaves.plan_insert import PITCH_M, PlanInsert
from phyagentos.runtime.motion.poses import point_tool_down
from phyagentos.runtime.motion.requests import Payload

TREE = [
    "plan_grasp: {object: red_cube, approaches: $ways}",
    "move_to: {approaches: $ways, approach: $down}",
    "move_linear: {approach: $down, stop_n: 15.0}",
]


@pytest.mark.parametrize(
    ("forces_n", "code"),
    [
        ((0.0, 16.0, 16.0), "CONTACT"),
        ((14.0, 14.0, 14.0), ""),
        ((None, None, None), ""),
        ((34.0, 33.0, 0.0), ""),  # a try that met the rim leaves it, pressed as it is
        ((34.0, 45.0, 0.0), "CONTACT"),
        ((34.0, 0.0, 16.0), "CONTACT"),
    ],
)
def test_a_guarded_motion_stops_when_the_target_feels_more_than_allowed_and_than_where_it_began(
    build_bench, session, plant, doubles, profile, forces_n, code
):
    """Forces are those at the upper end of the line, on it, and at its lower end."""
    bench = build_bench(target := doubles.PerfectTarget(profile, [doubles.make_cube()]), library=plant(TREE))
    step = target._step

    def feel():
        felt = step()
        part = np.searchsorted((0.22, 0.28), target.q[0] - profile.arm.home_rad[0])  # of the line, 0.2 to 0.3 rad
        return msgspec.structs.replace(felt, contact_force_n=forces_n[part])

    target._step = feel

    assert bench.run(session).code == code


def find_ends(activations, *, down=True):
    """Poses of the tool on each of so many ways; the peg is held 3 mm beside its middle."""
    hole = Interior((0.0, 0.0, 0.03), (0.016, 0.016, 0.02))
    socket = Entity(name="socket", kind="block", pose=Pose((0.5, 0.1, 0.0)), interior=hole)
    shape = Shape(ShapeKind.CYLINDER, (0.015, 0.04))
    peg = Entity(name="peg", kind="peg", pose=Pose((0.4, -0.1, 0.2)), shapes=(shape,))
    tcp = compute_pose(point_tool_down(0.0, np.array((0.4, -0.1, 0.22))))
    world = SimpleNamespace(observe=lambda need: SimpleNamespace(entities={"socket": socket, "peg": peg}))
    context = SimpleNamespace(world=world, step=SimpleNamespace(target=SimpleNamespace(tcp=tcp)))
    leaf = PlanInsert("plan", context)
    held = Payload("peg", Pose((0.003, 0.0, 0.02), (0.0, 1.0, 0.0, 0.0)))
    leaf.wire({"held": held, "socket": "socket", "down": down}, {"payload": "held", "socket": "socket", "down": "down"})
    leaf.request_line = lambda waypoints: waypoints
    for _ in range(activations):
        leaf.initialise()
        yield leaf.compose()


def test_the_first_way_down_ends_with_the_peg_over_the_middle_and_just_above_the_floor():
    (ways,) = find_ends(1)

    np.testing.assert_allclose(ways[-1].position_m[:2], (0.497, 0.1), atol=1e-9)
    assert ways[-1].position_m[2] == pytest.approx(0.01 + 0.0015 + 0.04 + 0.02)
    (over,) = find_ends(1, down=False)
    assert over[-1].position_m[2] - ways[-1].position_m[2] == pytest.approx(0.04 + 0.005 - 0.0015)
    assert over[0].position_m[2] == pytest.approx(0.22)  # it travels at the height at which it was lifted


def test_the_tries_cover_a_disc_of_which_no_point_is_farther_from_one_than_a_millimetre():
    ends = np.array([ways[-1].position_m[:2] for ways in find_ends(24)]) - (0.497, 0.1)

    assert np.linalg.norm(ends, axis=1).max() == pytest.approx(PITCH_M * np.sqrt(23))
    radii, angles = np.meshgrid(np.linspace(0.0, 0.003, 16), np.linspace(0.0, 2 * np.pi, 48))
    points = np.stack((radii * np.cos(angles), radii * np.sin(angles)), axis=-1).reshape(-1, 1, 2)
    assert np.linalg.norm(points - ends, axis=-1).min(axis=1).max() < 0.001
