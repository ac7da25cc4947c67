"""The robot's own solids at the measured joint positions, which mask its pixels.

The solids are grown for the calibration error of the cameras.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np

from phyagentos.geometry import as_pose
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.world.environment import Pose, ShapeKind, TargetState
from phyagentos.runtime.models.hand import measure_hand
from phyagentos.runtime.models.robot import compile_robot
from phyagentos.runtime.models.scene import GEOM_TYPES
from phyagentos.runtime.perception.solids import Array, Solids

LINK_M = 0.012  # links are drawn up to this much thicker than their collision solids, and cameras stand askew
TIP_M = 0.006  # the fingers are close to what they hold
_KINDS = {int(geom): kind for kind, geom in GEOM_TYPES.items()}


class RobotMask:
    """Poses the robot's solids; its fingers touch at most `reach_m` from the tool centre point."""

    def __init__(self, profile: TargetProfile, folder: Path) -> None:
        self.reach_m = profile.gripper.grasp_reach_m
        self._model = compile_robot(profile, folder)
        self._data = mujoco.MjData(self._model)
        self._tool = profile.tcp
        self._arm = [int(self._model.joint(name).qposadr[0]) for name in profile.arm.joints]
        self._hand = measure_hand(profile, folder)
        self.find_middle = self._hand.find_middle
        self._fingers = [int(self._model.joint(name).qposadr[0]) for name in self._hand.joints]
        tips = {int(self._model.joint(name).bodyid[0]) for name in self._hand.joints}
        model = self._model
        self._kinds, self._sizes, self._offsets = _read_geoms(model)
        self._grown = np.where(np.isin(model.geom_bodyid, list(tips)), TIP_M, LINK_M)

    def find_tool(self, q_rad: Sequence[float]) -> Pose:
        """`world_T_tcp` at joint positions (n_joints,) [rad]."""
        data = self._data
        data.qpos[self._arm] = q_rad
        mujoco.mj_kinematics(self._model, data)
        tool = data.site(self._tool)
        return as_pose(tool.xmat.reshape(3, 3), tool.xpos)

    def find_width(self, positions: Mapping[str, float]) -> float:
        """The opening [m] at which joints of the gripper have these positions, by the first of them."""
        name, position = next(iter(positions.items()))
        course = self._hand.postures[:, self._hand.joints.index(name)]
        rising = np.argsort(course)
        return float(np.interp(position, course[rising], self._hand.widths_m[rising]))

    def pose(self, state: TargetState) -> Solids:
        """Its solids in the world, at the measured joint positions."""
        data = self._data
        data.qpos[self._arm] = state.q_rad
        data.qpos[self._fingers] = self._hand.pose(state.gripper_width_m)
        mujoco.mj_kinematics(self._model, data)
        rotations = np.array(data.geom_xmat).reshape(-1, 3, 3)
        return Solids(
            self._kinds,
            self._sizes,
            rotations,
            positions_m=np.array(data.geom_xpos) + np.einsum("kij,kj->ki", rotations, self._offsets),
            inflate_m=self._grown,
        )


def _read_geoms(model: mujoco.MjModel) -> tuple[tuple[ShapeKind, ...], tuple[tuple[float, ...], ...], Array]:
    """Kinds and sizes of all geoms, and (k, 3) their middles in their frames; bounding boxes for meshes."""
    kinds, sizes, offsets = [], [], np.zeros((model.ngeom, 3))
    for geom in range(model.ngeom):
        kind = _KINDS.get(int(model.geom_type[geom]))
        size = model.geom_size[geom].tolist()
        if kind is None:
            offsets[geom], size = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:].tolist()
        kinds.append(kind or ShapeKind.BOX)
        sizes.append(tuple(size[: {ShapeKind.BOX: 3, ShapeKind.SPHERE: 1}.get(kinds[-1], 2)]))
    return tuple(kinds), tuple(sizes), offsets
