"""Each fault does what it says, by physical means, and strikes again from its own record."""

import json

import mujoco
import numpy as np
import pytest

from phyagentos.protocol.world.faults import Draw, FaultFile
from phyagentos.runtime.drivers.mujoco.faults import draw_fault, read_activations
from phyagentos.runtime.targets import wire

pytestmark = pytest.mark.sim


def make_file(**fault) -> FaultFile:
    return FaultFile.model_validate({"version": 1, "faults": [fault]})


@pytest.fixture
def begin(make_rig, tmp_path):
    rigs = []

    def begin(**fault):
        rigs.append(make_rig(log=tmp_path / "log.jsonl", schedule=make_file(**fault)))
        rigs[-1].load()
        rigs[-1].begin()
        return rigs[-1]

    yield begin
    rigs[-1].world.close()
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert sum(line["kind"] == "state_write" for line in lines) == 1, "a fault wrote simulator state"


def end(rig) -> tuple[wire.RecordedFault, ...]:
    return rig.world.handle(wire.End(session=rig.session, epoch=rig.epoch)).faults


def test_a_slip_lets_a_held_cube_fall_and_friction_comes_back(begin):
    rig = begin(kind="slip", object="red_cube", when={"lifted_m": 0.08}, duration_s=0.4)
    rig.grasp("red_cube")
    rig.hold(0.0, 1.0)
    assert rig.entity("red_cube").pose.position_m[2] < 0.03
    assert [fault.kind for fault in end(rig)] == ["slip"]
    rig.begin("again")
    rig.hold(0.08, 0.5)
    assert rig.grasp("green_cube").target.holding == ("green_cube",)


def test_a_nudge_takes_the_cube_from_between_the_fingers_and_leaves_it_on_the_table(begin):
    rig = begin(kind="nudge", object="red_cube", when={"gripper_near_m": 0.04})
    before = np.array(rig.entity("red_cube").pose.position_m)
    step = rig.grasp("red_cube")
    after = np.array(rig.entity("red_cube").pose.position_m)
    assert step.target.holding == ()
    assert 0.03 < np.linalg.norm((after - before)[:2]) < 0.12
    assert abs(after[2] - 0.02) < 0.003


@pytest.mark.parametrize("slender", [1, 50])
def test_a_person_moves_a_cube_or_a_slender_rod_that_turns_and_puts_it_down(begin, slender):
    """Damped by its greatest inertia, a rod spun faster with every step, until the simulator began anew."""
    rig = begin(kind="move", object="red_cube", when={"time_s": 0.5}, to_m=(0.45, -0.28), duration_s=1.0)
    model = rig.world.driver.physics.model
    model.body_inertia[model.body("red_cube").id][2] /= slender
    mujoco.mj_setConst(model, mujoco.MjData(model))
    rig.hold(0.08, 2.5)
    entity = rig.entity("red_cube")
    assert np.linalg.norm(np.array(entity.pose.position_m) - (0.45, -0.28, 0.02)) < 0.015
    assert entity.speed_m_s < 0.01 or slender > 1


def test_a_place_that_nobody_chose_is_free_and_within_reach(begin):
    rig = begin(kind="move", object="red_cube", when={"time_s": 0.5})
    before = np.array(rig.entity("red_cube").pose.position_m)
    rig.hold(0.08, 2.5)
    after = np.array(rig.entity("red_cube").pose.position_m)
    assert 0.04 < np.linalg.norm((after - before)[:2]) < 0.15
    assert 0.33 < np.linalg.norm(after[:2]) < 0.68


def test_a_removed_cube_is_off_the_table(begin):
    rig = begin(kind="remove", object="red_cube", when={"time_s": 0.5})
    rig.hold(0.08, 3.0)
    assert rig.entity("red_cube").pose.position_m[2] < -0.3


def test_a_stalled_joint_does_not_turn_and_recovers(begin):
    rig = begin(kind="stall", joint="joint1", when={"time_s": 0.5}, duration_s=1.0)
    goal = np.array(rig.driver.controller.q_rad) + np.array([0.4, 0, 0, 0, 0, 0, 0])
    rig.hold(0.08, 0.3)
    stalled = rig.move(goal, seconds=0.6)
    assert abs(stalled.target.q_rad[0]) < 0.05
    assert stalled.tracking_error_rad > 0.3
    assert abs(rig.move(goal, seconds=1.5).target.q_rad[0] - 0.4) < 0.02


def test_a_push_bends_the_arm_that_way_and_ends(begin):
    rig = begin(
        kind="push", joint="joint6", when={"time_s": 1.0}, force_n=60.0, direction_rad=np.pi / 2, duration_s=0.5
    )
    rig.hold(0.08, 0.2)
    before = np.array(rig.observe().target.tcp.position_m)
    rig.hold(0.08, 1.2 - rig.driver.physics.time_s)
    aside = np.array(rig.observe().target.tcp.position_m) - before
    assert aside[1] > 0.001
    assert abs(aside[1]) > 3 * np.abs(aside[[0, 2]]).max()
    rig.hold(0.08, 1.0)
    assert np.abs(np.array(rig.observe().target.tcp.position_m) - before).max() < 0.001
    assert not rig.driver.physics.data.xfrc_applied.any()
    assert [(fault.kind, fault.details["body"]) for fault in end(rig)] == [("push", "joint6")]


def test_a_fault_waits_for_the_session_it_is_meant_for(begin):
    rig = begin(kind="move", object="red_cube", when={"session": "b*", "time_s": 0.0}, to_m=(0.45, -0.28))
    rig.hold(0.08, 0.5)
    assert end(rig) == ()
    rig.begin("b1")
    rig.hold(0.08, 0.5)
    assert [fault.kind for fault in end(rig)] == ["move"]


def test_a_recorded_fault_repeats_itself_bit_for_bit(make_rig):
    states, recorded = [], ()
    for attempt in range(2):
        schedule = make_file(kind="move", object="red_cube", when={"time_s": 0.6}) if not attempt else recorded
        rig = make_rig(schedule=schedule)
        rig.load()
        rig.begin()
        rig.hold(0.08, 2.0)
        states.append(rig.observe().snapshot.data)
        if not attempt:
            recorded = read_activations(end(rig))
    assert states[0] == states[1]


def test_a_drawn_fault_follows_from_its_seed_and_all_kinds_come_up():
    draw = Draw(one_of=("slip", "nudge", "move", "stall"), objects=("red_cube", "green_cube"))
    faults = [draw_fault(draw, seed) for seed in range(40)]
    assert faults == [draw_fault(draw, seed) for seed in range(40)]
    assert {fault.kind for fault in faults} == {"slip", "nudge", "move", "stall"}
    assert {fault.object for fault in faults} == {"red_cube", "green_cube"}
