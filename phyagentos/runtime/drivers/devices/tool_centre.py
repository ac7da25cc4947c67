"""The tool centre point of a real robot, which the guard watches, by the model of its profile."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.world.environment import Pose


class ToolCentre:
    """The tool centre point of an arm, by its MJCF; raises DefinitionError when the model is missing or unreadable."""

    def __init__(self, profile: TargetProfile, folder: Path) -> None:
        import mujoco

        from phyagentos.errors import DefinitionError
        from phyagentos.runtime.drivers.mujoco.kinematics import read_kinematics
        from phyagentos.runtime.models.robot import read_robot

        place, found = f"{profile.target}/target.yaml", read_robot(profile, folder).compile() if profile.model else None
        kinematics = read_kinematics(found, profile) if found is not None else None
        if found is None or kinematics is None:
            hint = "Copy the robot's model beside its profile; docs/targets.md says where from."
            raise DefinitionError.of("MODEL_MISSING", f"{place}: model", repr(profile.model), "a MJCF file", hint)
        self._model, self._data, self.kinematics = found, mujoco.MjData(found), kinematics
        self._q = [found.joint(name).qposadr[0] for name in profile.arm.joints]
        self._site = found.site(profile.tcp).id

    def locate(self, q_rad: NDArray[np.float64]) -> Pose:
        """Its pose in the world [m], of measured joints (n_joints,) [rad]."""
        import mujoco

        self._data.qpos[self._q] = q_rad
        mujoco.mj_kinematics(self._model, self._data)
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, self._data.site_xmat[self._site])
        w, x, y, z = quaternion.tolist()
        return Pose(tuple(self._data.site_xpos[self._site].tolist()), (w, x, y, z))
