"""What an imagined rollout is said to have failed by."""

from types import SimpleNamespace

from rollout_forecaster.playback import Rollout, find_cause

from phyagentos.protocol.world.environment import Entity, Environment, Interior, Pose
from phyagentos.testing import make_contract


def make_world(x_m):
    tray = Entity(
        name="tray", kind="tray", pose=Pose((0.6, 0.0, 0.0)), movable=False, interior=Interior((0, 0, 0.03), (0.1,) * 3)
    )
    cube = Entity(name="cube", kind="cube", pose=Pose((x_m, 0.0, 0.02)))
    return Environment(
        time_s=0.0, scene="s", episode="e", revision=1, sensing="truth", entities={"tray": tray, "cube": cube}
    )


def judge(x_m, *accept):
    session = make_contract(parameters={"object": "cube"}, accept=accept)
    rollout = Rollout(held=(), initial=make_world(0.3), terminal=make_world(x_m))
    return find_cause(rollout, rollout, SimpleNamespace(session=session))


def test_what_only_a_real_course_can_measure_is_not_held_against_an_imagined_one():
    assert judge(0.6, "inside(cube, tray)", "metric(peak_force_n) <= 20") == ""
    assert judge(0.4, "inside(cube, tray)", "metric(peak_force_n) <= 20") == "PLACED_WRONG"
