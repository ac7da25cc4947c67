"""The point of a real robot that the guard watches: its tool's, by the model of its profile, or the trunk's."""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.world.environment import Pose
from phyagentos.runtime.targets.wire import Kinematics


class ReferencePoint(Protocol):
    """Where a point is at joint positions."""

    @property
    def kinematics(self) -> Kinematics:
        """How it follows from the joints, for the guard."""

    def locate(self, q_rad: NDArray[np.float64]) -> Pose:
        """Its pose in the world, of joints (n_joints,)."""


@dataclass(frozen=True, slots=True)
class Trunk:
    """A trunk that stands where the profile mounts it, however the `n_joints` joints move."""

    profile: TargetProfile

    @property
    def kinematics(self) -> Kinematics:
        """Slides without effect."""
        n, mount_m = len(self.profile.arm.joints), self.profile.mount_position_m
        return Kinematics(((0.0, 0.0, 0.0),) * n, (mount_m,) * n, mount_m, (True,) * n)

    def locate(self, q_rad: NDArray[np.float64]) -> Pose:
        """The mount."""
        return Pose(self.profile.mount_position_m, self.profile.mount_quaternion_wxyz)


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
        """Of measured joints."""
        import mujoco

        self._data.qpos[self._q] = q_rad
        mujoco.mj_kinematics(self._model, self._data)
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, self._data.site_xmat[self._site])
        w, x, y, z = quaternion.tolist()
        return Pose(tuple(self._data.site_xpos[self._site].tolist()), (w, x, y, z))
