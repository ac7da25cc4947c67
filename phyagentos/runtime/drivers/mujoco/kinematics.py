"""The arm's joints in the compiled model, for `wire.Description`."""

import mujoco
import numpy as np

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.targets.wire import Kinematics

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


def read_kinematics(model: mujoco.MjModel, profile: TargetProfile, prefix: str = "") -> Kinematics | None:
    """Axes and anchors at joint positions zero, in the world frame; None when a joint neither turns nor slides.

    A joint that does not carry the tool, as of another leg, is a slide without effect.
    """
    joints = [model.joint(prefix + name) for name in profile.arm.joints]
    kinds = [int(joint.type[0]) for joint in joints]
    if not {_HINGE, _SLIDE}.issuperset(kinds):
        return None
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0
    for joint in joints:
        data.qpos[joint.qposadr[0]] = 0.0
    mujoco.mj_kinematics(model, data)
    ids, tool = np.array([joint.id for joint in joints]), model.site(prefix + profile.tcp)
    carriers = {body := int(model.site_bodyid[tool.id])}
    while body := int(model.body_parentid[body]):
        carriers.add(body)
    carries = np.isin(model.jnt_bodyid[ids], list(carriers))
    slides = tuple(kind == _SLIDE or not carry for kind, carry in zip(kinds, carries.tolist(), strict=True))
    return Kinematics(
        axes=_as_triples(data.xaxis[ids] * carries[:, None]),
        anchors_m=_as_triples(data.xanchor[ids]),
        tcp_m=_as_triples(data.site_xpos[tool.id][None])[0],
        slides=slides if any(slides) else (),
    )


def _as_triples(rows: np.ndarray) -> tuple[tuple[float, float, float], ...]:
    return tuple((float(x), float(y), float(z)) for x, y, z in rows)
