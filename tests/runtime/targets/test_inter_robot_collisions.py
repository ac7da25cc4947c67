"""Announced motions of two arms at one table: admitted where they keep their distance, in the order of names."""

from itertools import product

import mujoco
import numpy as np
import pytest

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.drivers.mujoco.inter_robot_collisions import CLEARANCE_M, sample
from phyagentos.runtime.targets import wire
from tests.runtime.targets.test_shared_world import EXAMPLE, Table

pytestmark = pytest.mark.sim

INWARDS = {"left_arm": -1.2, "right_arm": 1.2}  # turns of the first joint that bring the hands over the middle [rad]


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return Workspace.create(tmp_path_factory.mktemp("w"), Library.open(EXAMPLE)).library()


def plan(target, turn_rad, lean_rad=0.6, rows=200):
    """Turn to the side and lean forward (rows, 7)."""
    q = np.tile(np.array(target.robot.controller.q_rad), (rows, 1))
    q[:, :2] += np.linspace(0.0, 1.0, rows)[:, None] * (turn_rad, lean_rad)
    return q


def announce(target, q_rad, session="s", **settings):
    return target.handle(wire.Announce(session=session, epoch=1, q_rad=q_rad, **settings))


def measure(table, q_left, q_right):
    """How near the arms come in any two postures, by another function of MuJoCo, pair by pair of solids [m]."""
    physics = table.left.robot.physics
    model, data = physics.model, mujoco.MjData(physics.model)
    data.qpos[:] = physics.data.qpos
    solid = [g for g in range(model.ngeom) if model.geom_contype[g] or model.geom_conaffinity[g]]
    sides = [[g for g in solid if model.body(model.geom_bodyid[g]).name.startswith(arm)] for arm in INWARDS]
    nearest = np.inf
    for left, right in product(q_left, q_right):
        data.qpos[table.left.robot.physics.state.q_address], data.qpos[table.right.robot.physics.state.q_address] = (
            left,
            right,
        )
        mujoco.mj_kinematics(model, data)
        for a, b in product(*sides):
            if np.linalg.norm(data.geom_xpos[a] - data.geom_xpos[b]) < 0.1 + model.geom_rbound[[a, b]].sum():
                nearest = min(nearest, mujoco.mj_geomDistance(model, data, a, b, 0.1, None))
    return nearest


def begin_both(library, **settings):
    table = Table(library, **settings)
    for target in table.targets:
        table.begin(target)
    return table


@pytest.mark.parametrize("first", [0, 1])
def test_of_two_motions_that_cross_that_of_the_first_name_is_admitted_whichever_comes_first(library, first):
    table = begin_both(library)
    works = [lambda t=target: announce(t, plan(t, INWARDS[t.robot.profile.target])) for target in table.targets]

    order = works if not first else works[::-1]
    left, right = table.together(*order)[:: 1 if not first else -1]

    assert (left, right) == (wire.Admission(), wire.Admission("left_arm"))
    assert table.simulation.time_s == table.left.robot.world.simulation.time_s


def test_an_admitted_motion_keeps_its_distance_and_a_refused_one_would_not(library):
    table = begin_both(library)
    rng, found = np.random.default_rng(4), {True: 0, False: 0}
    stay = plan(table.left, 0.0, 0.0, rows=1)
    q_right = plan(table.right, INWARDS["right_arm"], 0.6)[-1:]
    table.together(lambda: announce(table.left, stay), lambda: announce(table.right, q_right))
    for turn_rad, lean_rad in rng.uniform((-2.0, 0.2), (-0.6, 1.2), (12, 2)):
        q_left = plan(table.left, turn_rad, lean_rad)
        left, _ = table.together(lambda q=q_left: announce(table.left, q), lambda: announce(table.right, q_right))
        is_admitted = left == wire.Admission()
        found[is_admitted] += 1
        nearest_m = measure(table, sample(q_left)[::3], q_right)
        assert (nearest_m >= CLEARANCE_M - 1e-4) >= is_admitted, (turn_rad, lean_rad, nearest_m)
        if not is_admitted:
            assert measure(table, sample(q_left), q_right) < CLEARANCE_M + 1e-4
    assert min(found.values()) > 1, found


def test_a_neighbour_is_seen_with_what_is_left_of_its_motion_until_it_rests(library):
    table = begin_both(library)
    q = plan(table.left, 0.3)
    table.together(lambda: announce(table.left, q), lambda: announce(table.right, plan(table.right, 0.0, 0.0, rows=1)))

    (seen,) = table.right.handle(wire.Observe()).neighbours
    assert seen.name == "left_arm"
    assert seen.target.q_rad == table.left.handle(wire.Observe()).target.q_rad
    assert np.allclose(seen.announced_rad[[0, -1]], q[[0, -1]])
    table.together(lambda: table.swing(table.left, periods=10), lambda: table.swing(table.right, periods=10))
    later = table.right.handle(wire.Observe()).neighbours[0].announced_rad
    assert np.allclose(later[-1], q[-1])
    assert later[0, 0] > q[50, 0]
    table.together(*(lambda t=target: t.handle(wire.Halt(session="s", epoch=1)) for target in table.targets))
    assert not len(table.right.handle(wire.Observe()).neighbours[0].announced_rad)


def test_arms_that_touch_report_it_once_each_with_the_name_of_the_other(library):
    table = begin_both(library)
    for target in table.targets:  # their own limits refuse every command that leads here
        physics = target.robot.physics
        physics.data.qpos[physics.state.q_address] = plan(target, 1.6 * INWARDS[target.robot.profile.target], 0.9)[-1]
    with table.simulation.lock:
        table.simulation.pass_period()

    touched = [target.robot.report().touched_n for target in table.targets]
    assert [set(each) for each in touched] == [{"right_arm"}, {"left_arm"}]
    assert touched[0]["right_arm"] == touched[1]["left_arm"] > 0.0
    assert not table.left.robot.report().touched_n


def test_an_announcement_that_is_no_motion_of_this_arm_is_refused(library):
    table = begin_both(library)
    wrong = (np.zeros((3, 6)), np.zeros((0, 7)), np.full((3, 7), np.nan))
    assert {announce(table.left, q).code for q in wrong} == {"MALFORMED"}
    assert announce(table.left, np.zeros((3, 7)), session="another").code == "NO_AUTHORITY"
