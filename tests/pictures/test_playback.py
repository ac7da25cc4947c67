"""Postures in a scene: an arm by its joints, a base that drives or walks by its free joint."""

import mujoco
import numpy as np
import pytest

from phyagentos.pictures.playback import follow_beats, set_posture
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.sessions.heartbeats import Heartbeat
from phyagentos.runtime.models.base import FREE_JOINT

LIBRARY = Library.open()
TARGETS = [
    name for name in LIBRARY.names_of_targets() if read_target(LIBRARY.get_target(name)).arm.joints[:1] == ("base_x",)
]


def make_scene(profile, prefix=""):
    """A free base, turned at home as its model is, with a hinge and the tool's site for each joint of the arm."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name=f"{prefix}body", pos=(0, 0, 0.3), quat=(np.sqrt(0.5), 0, 0, -np.sqrt(0.5)))
    body.add_freejoint(name=prefix + FREE_JOINT)
    body.add_site(name=prefix + profile.tcp)
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.1, 0, 0))
    for name in profile.arm.joints[3:]:
        body = body.add_body(name=f"{prefix}of_{name}")
        body.add_joint(name=prefix + name)
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.1, 0, 0))
    return spec.compile()


@pytest.mark.parametrize("several", [False, True])
@pytest.mark.parametrize("name", TARGETS)
def test_a_base_stands_where_it_was_measured_upright_and_turned_from_its_home(name, several):
    profile = read_target(LIBRARY.get_target(name))
    model = make_scene(profile, f"{name}/" if several else "")
    qpos = model.qpos0.copy()
    q = np.arange(len(profile.arm.joints)) / 10.0
    q[:3] = 1.5, -0.5, profile.arm.home_rad[2] + np.pi / 2

    set_posture(model, qpos, profile, q)

    assert qpos[:3] == pytest.approx([1.5, -0.5, 0.3])
    assert qpos[3:7] == pytest.approx([1.0, 0.0, 0.0, 0.0])  # a quarter of a turn more than at home
    assert qpos[7:] == pytest.approx(q[3:])


def test_robots_that_drive_and_walk_are_among_those_that_ship():
    assert {"go2", "lekiwi", "r1"} <= set(TARGETS)


def test_every_robot_of_a_shared_world_stands_as_its_own_heartbeat_says():
    spec, panda = mujoco.MjSpec(), read_target(LIBRARY.get_target("panda"))
    robots = {name: panda.model_copy(update={"target": name}) for name in ("left", "right", "still")}
    for name in robots:
        body = spec.worldbody
        for joint in (*panda.arm.joints, *panda.gripper.joints):
            body = body.add_body(name=f"{name}/of_{joint}")
            is_finger = joint in panda.gripper.joints
            kind = mujoco.mjtJoint.mjJNT_SLIDE if is_finger else mujoco.mjtJoint.mjJNT_HINGE
            body.add_joint(name=f"{name}/{joint}", type=kind)
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.1, 0, 0))
        body.add_site(name=f"{name}/{panda.tcp}")
    data = mujoco.MjData(model := spec.compile())
    beats = {
        name: Heartbeat(target=name, pid=1, q_rad=(angle,) * 7, gripper_width_m=0.04)
        for name, angle in (("left", 0.1), ("right", 0.2), ("elsewhere", 0.3))
    }

    follow_beats(model, data, robots, beats | {"still": Heartbeat(target="still", pid=1)})

    assert data.qpos == pytest.approx([0.1] * 7 + [0.02] * 2 + [0.2] * 7 + [0.02] * 2 + [0.0] * 9)
