"""Under perceived sensing nothing that decides comes from the simulator's truth: poisoned, it changes no bit."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.sessions import evidence
from phyagentos.protocol.sessions.session import Ended, GoalId, Scene, SessionId
from phyagentos.protocol.settings.sensors import read_sensors
from phyagentos.protocol.world.environment import Environment, Pose
from phyagentos.runtime.drivers.mujoco.world import MujocoDriver, SimulatedWorld
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.process import LocalPlanner
from phyagentos.runtime.perception.perceived_world import PerceivedWorld
from phyagentos.runtime.perception.robot_mask import RobotMask
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget

pytestmark = [pytest.mark.sim, pytest.mark.motion]


class PoisonedWorld(MujocoDriver):
    """Tells the truth about itself and lies about everything that only a simulator can know."""

    def observe(self, *, truth):
        seen = super().observe(truth=truth)
        entities = tuple(msgspec.structs.replace(each, pose=_shift(each.pose)) for each in seen.entities)
        regions = tuple(msgspec.structs.replace(each, pose=_shift(each.pose)) for each in seen.regions)
        return msgspec.structs.replace(seen, entities=entities, regions=regions, target=_rename(seen.target))

    def report(self):
        step = super().report()
        return msgspec.structs.replace(step, target=_rename(step.target))


def _shift(pose):
    x, y, z = pose.position_m
    return Pose((x + 1.0, y, z), pose.quaternion_wxyz)


def _rename(state):
    return msgspec.structs.replace(state, holding=("bottle",) if state.holding else ("red_tray",))


@pytest.fixture
def run_session(build_bench, build_session, library, profile):
    planner = MotionPlanner.open(library.get_target("panda"))

    def run(kind):
        folder = library.get_target("panda").parent
        sensors = read_sensors(find_shipped_root() / "protocol" / "sensors.yaml")
        world = ServedTarget(kind(SimulatedWorld(library, sensors=sensors), profile, folder), ReceiveLog(None))
        bench = build_bench(target=world, planner=LocalPlanner(planner), clock=SystemClock())
        seen = PerceivedWorld("panda", bench.handle, library, RobotMask(profile, folder), moving=("wrist",))
        bench.runner._world, bench.runner._target = seen, replace(bench.runner._target, world=seen)
        session = build_session(
            id=SessionId(f"tidy-2.{kind.__name__}"),
            goal=GoalId("tidy-2"),
            skill="pick_and_place",
            parameters={"object": "red_cube", "destination": "red_tray"},
            seed=2,
            hold=("upright(bottle)",),
            scene=Scene(name="tabletop/cubes_and_trays", seed=2, episode="tidy-2"),
        )
        return bench.run(session), bench.workspace / f"evidence/{session.id}"

    return run


def test_a_poisoned_truth_changes_no_bit_of_a_perceived_session(run_session):
    honest, first = run_session(MujocoDriver)
    poisoned, second = run_session(PoisonedWorld)

    assert honest.ended is poisoned.ended is Ended.COMPLETED, (honest, poisoned)
    assert honest.outputs == poisoned.outputs
    for name in (evidence.BEFORE, evidence.AFTER, evidence.TRACE, evidence.HOLDS):
        assert (first / name).read_bytes() == (second / name).read_bytes(), name
    with np.load(first / evidence.TRAJECTORY) as one, np.load(second / evidence.TRAJECTORY) as two:
        assert all(one[name].tobytes() == two[name].tobytes() for name in one.files)
    after = msgspec.json.decode((first / evidence.AFTER).read_bytes(), type=Environment)
    assert after.sensing == "perceived"
    assert after.entities["red_cube"].pose.position_m[1] > 0.2
