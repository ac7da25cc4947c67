"""How a gripper's joints stand at an opening, and what its drive is commanded: plain for slides, else measured.

A jaw that turns, or a linkage, is driven through a series of set-points in a copy of the robot without contacts; at
each one the gap between the pads and the posture of all its joints are taken. Between them is interpolated.
"""

import functools
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.models.compiling import compile_model
from phyagentos.runtime.models.robot import GRIPPER_ACTUATOR, build_robot
from phyagentos.runtime.models.sources import find_model, find_models

Array = NDArray[np.float64]
SETTINGS, SETTLE_S = 25, 0.4  # set-points of the drive, and what each is given to come to rest
FAR_M = 1.0


@dataclass(frozen=True, slots=True)
class HandMotion:
    """A gripper between closed and open; `joints` are all that move, those that follow included.

    Attributes:
        widths_m: (k,) openings, ascending from closed.
        drive: (k,) length of the drive's tendon at each.
        postures: (k, n) joint positions at each.
        middles_m: (k,) place of the middle between the pads along the closing axis, from the tool centre point; other
            than zero where one jaw stands still.
    """

    joints: tuple[str, ...]
    widths_m: Array
    drive: Array
    postures: Array
    middles_m: Array

    def pose(self, width_m: float) -> Array:
        """(n,) joint positions at an opening [m]."""
        return np.array([np.interp(width_m, self.widths_m, column) for column in self.postures.T])

    def find_middle(self, width_m: float) -> float:
        """Where the middle of what is held is along the closing axis, from the tool centre point [m]."""
        return float(np.interp(width_m, self.widths_m, self.middles_m))

    def compute_drive(self, width_m: Array) -> Array:
        """Lengths of the drive's tendon for openings (n,) [m]."""
        return width_m if self.drive is self.widths_m else np.interp(width_m, self.widths_m, self.drive)

    def compute_width(self, drive: float) -> float:
        """Opening [m] at a length of the drive's tendon."""
        if self.drive is self.widths_m:
            return drive
        way = 1 if self.drive[0] < self.drive[-1] else -1  # a drive that lengthens while it closes is read backwards
        return float(np.interp(drive, self.drive[::way], self.widths_m[::way]))


def measure_hand(profile: TargetProfile, folder: Path) -> HandMotion:
    """The motion of a target's gripper, whose model is relative to `folder`; once per file and process.

    Raises:
        DefinitionError: `MODEL_INVALID` where the model does not open as wide as the profile says.
    """
    gripper = profile.gripper
    if not gripper.travel:
        widths_m, share = np.array([0.0, gripper.max_width_m]), max(len(gripper.joints), 1)
        return HandMotion(
            gripper.joints,
            widths_m,
            widths_m,
            postures=np.outer(widths_m / share, np.ones(len(gripper.joints))),
            middles_m=np.zeros(2),
        )
    if len(gripper.pads) != 2 or len(gripper.travel) != len(gripper.joints):
        raise DefinitionError.of(
            "INVALID_VALUE",
            f"{profile.target}/target.yaml: gripper",
            found=f"{len(gripper.pads)} pads, {len(gripper.joints)} joints and {len(gripper.travel)} values of travel",
            expected="two pads that face each other, and a value for each joint",
        )
    return _measure(profile, folder, find_model(profile.model, folder).stat().st_mtime_ns)


@functools.lru_cache(maxsize=16)
def _measure(profile: TargetProfile, folder: Path, _changed_ns: int) -> HandMotion:
    spec = build_robot(profile, folder)
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_GRAVITY
    spec.option.timestep, spec.option.integrator = profile.physics_step_s, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model = compile_model(spec, *find_models(profile, folder))
    data, servo, gripper = mujoco.MjData(model), model.actuator(GRIPPER_ACTUATOR).id, profile.gripper
    arm = [model.joint(name) for name in profile.arm.joints]
    data.qpos[[int(joint.qposadr[0]) for joint in arm]] = profile.arm.home_rad
    home = profile.arm.home_rad[profile.servoed]
    data.ctrl[: len(home)] = home
    joints = [model.joint(index) for index in range(model.njnt) if model.joint(index).name not in profile.arm.joints]
    address = [int(joint.qposadr[0]) for joint in joints]
    ranges = np.array([model.joint(name).range for name in gripper.joints]) * np.array(gripper.travel)[:, None]
    pads = [model.geom(name).id for name in gripper.pads]
    tool, ends, rows = model.site(profile.tcp).id, np.empty(6), []
    for drive in np.linspace(ranges.min(axis=1).sum(), ranges.max(axis=1).sum(), SETTINGS).tolist():
        data.ctrl[servo] = drive
        mujoco.mj_step(model, data, nstep=round(SETTLE_S / profile.physics_step_s))
        gap_m = mujoco.mj_geomDistance(model, data, pads[0], pads[1], FAR_M, ends)
        middle_m = float(((ends[:3] + ends[3:]) / 2 - data.site_xpos[tool]) @ data.site_xmat[tool].reshape(3, 3)[:, 1])
        rows.append((max(gap_m, 0.0), float(data.actuator_length[servo]), middle_m, *data.qpos[address]))
    found = np.array(sorted(rows))
    kept = np.r_[np.diff(found[:, 0]) > 0.0, True]  # of all that are closed, the last one
    found = found[kept]
    if found[-1, 0] < gripper.max_width_m - 1e-3 or len(found) < 3:
        raise DefinitionError.of(
            "MODEL_INVALID",
            address=f"{profile.target}/target.yaml: gripper.max_width_m",
            found=f"{gripper.max_width_m} m",
            expected=f"at most {found[-1, 0]:.4f} m, between {' and '.join(gripper.pads)} in the model",
        )
    return HandMotion(tuple(joint.name for joint in joints), found[:, 0], found[:, 1], found[:, 3:], found[:, 2])
