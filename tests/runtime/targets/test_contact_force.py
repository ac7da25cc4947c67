"""What an arm feels of its contacts: nothing in the air, little of a soft placement, much of a bump."""

import numpy as np
import pytest

from phyagentos.agent.judging.judges.metrics import read_course
from phyagentos.runtime.actions.set_points import SetPoints
from phyagentos.runtime.targets import wire
from phyagentos.runtime.worker.recorder import Recorder

pytestmark = pytest.mark.sim

PEAK = "peak_force_n"
CUBE = "red_cube"


@pytest.fixture
def rig(make_rig):
    rig = make_rig()
    rig.load()
    rig.begin()
    rig.grasp(CUBE)
    return rig


def lower(rig, depth_m, seconds, folder):
    """Bring the held cube down to `depth_m` below where it stands on the table; recorded as a runner would."""
    x, y, _ = rig.entity(CUBE).pose.position_m
    height_m = rig.observe().target.tcp.position_m[2] - rig.entity(CUBE).pose.position_m[2] + 0.02
    recorder = Recorder(folder / "evidence")
    for q, qd in rig.plan(rig.reach((x, y, height_m - depth_m)), seconds):
        step = rig.send(rig.make_command(q, 0.0, qd))
        assert isinstance(step, wire.Step), step
        recorder.on_step(SetPoints(q, qd, np.zeros(len(q))), step)
        if step.stopped:
            break
    recorder.on_rest(rig.world.handle(wire.Halt(session="s", epoch=1)))
    recorder.write_course(trace=(), events=(), holds=(), faults=(), n_joints=7)
    return read_course(folder / "evidence", {PEAK})[PEAK]


def test_a_soft_placement_is_felt_less_than_a_bump(rig, tmp_path):
    assert lower(rig, 0.0005, 2.0, tmp_path / "soft") < 20.0


def test_a_hard_bump_is_felt(rig, tmp_path):
    assert lower(rig, 0.008, 0.6, tmp_path / "hard") > 20.0
