"""The arm's hinges as the live model has them, for whoever must know where a commanded posture ends.

Upstream: the compiled model. Downstream: `wire.Description`.
"""

import mujoco
import numpy as np

from phyagentos.protocol.targets import TargetProfile
from phyagentos.runtime.targets.wire import Kinematics


def read_kinematics(model: mujoco.MjModel, profile: TargetProfile) -> Kinematics | None:
    """Axes and anchors at joint angles zero, in the world frame; None when a joint of the arm is no hinge."""
    joints = [model.joint(name) for name in profile.arm.joints]
    if any(int(joint.type[0]) != int(mujoco.mjtJoint.mjJNT_HINGE) for joint in joints):
        return None
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0
    for joint in joints:
        data.qpos[joint.qposadr[0]] = 0.0
    mujoco.mj_kinematics(model, data)
    ids = np.array([joint.id for joint in joints])
    return Kinematics(
        axes=_as_triples(data.xaxis[ids]),
        anchors_m=_as_triples(data.xanchor[ids]),
        tcp_m=_as_triples(data.site_xpos[model.site(profile.tcp).id][None])[0],
    )


def _as_triples(rows: np.ndarray) -> tuple[tuple[float, float, float], ...]:
    return tuple((float(x), float(y), float(z)) for x, y, z in rows)
