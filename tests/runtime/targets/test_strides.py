"""Physics steps in one compiled stride are those that are taken one by one: the same reports, bit for bit."""

import numpy as np
import pytest

from phyagentos.protocol.world.faults import Stall, When
from phyagentos.runtime.drivers.mujoco.faults import Schedule
from phyagentos.runtime.drivers.mujoco.stride import Stride, Strider
from phyagentos.runtime.targets import wire

pytestmark = pytest.mark.sim

CUBE = "red_cube"
NEVER = Schedule((Stall(kind="stall", when=When(time_s=1e6)),))  # a fault that may act is looked for before every step


def press(rig, depth_m=0.008):
    """Take a cube, and press it into the table until the arm stops by itself; the reports of the pressing."""
    rig.load()
    rig.begin()
    rig.grasp(CUBE)
    x, y, _ = rig.entity(CUBE).pose.position_m
    height_m = rig.observe().target.tcp.position_m[2] - rig.entity(CUBE).pose.position_m[2] + 0.02
    reports = []
    for q, qd in rig.plan(rig.reach((x, y, height_m - depth_m)), 0.6):
        reports.append(rig.send(rig.make_command(q, 0.0, qd)))
        if reports[-1].stopped:
            break
    rig.driver.hold(0.1)  # with the force of the contact
    return [wire.REPLIES.encode(each) for each in reports], reports[-1].stopped


@pytest.fixture
def panda(panda):
    """An arm that a small force stops."""
    profile, folder = panda
    return profile.model_copy(update={"contact_force_n": 20.0}), folder


@pytest.fixture
def strides(monkeypatch):
    taken: list[Stride] = []
    take = Strider.take

    def note(self, controls):
        taken.append(take(self, controls))
        return taken[-1]

    monkeypatch.setattr(Strider, "take", note)
    return taken


def test_a_grasp_and_a_collision_are_the_same_in_strides_and_step_by_step(make_rig, strides):
    in_strides = make_rig()
    found = press(in_strides)
    kinds = {(each.steps == 10, each.is_felt) for each in strides if each.steps}
    strides.clear()
    one_by_one = make_rig(schedule=NEVER)

    assert found == press(one_by_one)
    assert found[1] == "COLLISION_STOP"
    assert {(True, False), (False, True)} <= kinds
    assert sum(each.steps for each in strides) == 0
    for name, value in in_strides.read_state().items():
        assert np.array_equal(value, one_by_one.read_state()[name]), name


def test_a_stride_ends_before_an_input_that_must_be_bounded(rig, strides):
    controller, physics = rig.driver.controller, rig.driver.physics
    controls = np.tile(physics.data.ctrl[physics.actuation.inputs], (10, 1))
    controls[4:, 3] += 1.0  # faster than the joint may follow
    began_s = physics.time_s

    stride = controller._strider.take(controls)

    assert stride == Stride(4, is_felt=False)
    assert physics.time_s - began_s == pytest.approx(4 * physics.model.opt.timestep)
