"""One session over time, from its evidence alone: states of the world, paths of the tool, what was believed.

Where a bundle holds `motion.npz` (simulated targets) every body is where it was. Elsewhere the robot moves as it was
measured, and objects stand where they stood at the start, until the end. A runner that was lost leaves no trajectory:
there is no path of the tool then.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import ExecutionError
from phyagentos.geometry import multiply
from phyagentos.pictures.model_file import read_model
from phyagentos.protocol.capabilities.registries import get_registered_target
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions import evidence
from phyagentos.protocol.sessions.evidence import Bundle, read_bundle
from phyagentos.protocol.sessions.heartbeats import Heartbeat
from phyagentos.protocol.sessions.session import SessionStatus
from phyagentos.protocol.workspace.array_files import read_arrays
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import Environment

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Playback:
    """States of the world of one session.

    Attributes:
        model: The compiled scene.
        time_s: (n,) moments, growing, in the target's own time [s].
        qpos: (n, nq) positions of all joints at these moments.
        measured_m: (k, 3) places of the tool as measured, in the world [m].
        planned_m: (k, 3) its places as commanded [m].
        bundle: What else was left: trace, events, the world as believed before and after.
    """

    model: mujoco.MjModel
    time_s: Array
    qpos: Array
    measured_m: Array
    planned_m: Array
    bundle: Bundle

    def pose(self, time_s: float, data: mujoco.MjData | None = None) -> mujoco.MjData:
        """The world at the latest moment up to `time_s`, with its kinematics; in `data` where one is given."""
        data = data or mujoco.MjData(self.model)
        data.qpos[:] = self.qpos[max(0, int(np.searchsorted(self.time_s, time_s + 1e-9)) - 1)]
        mujoco.mj_forward(self.model, data)
        return data

    def believe(self, time_s: float) -> Environment | None:
        """The latest snapshot of the world as believed, up to a moment."""
        after = self.bundle.after
        return after if after is not None and time_s >= after.time_s else self.bundle.before

    def tree_at(self, time_s: float) -> dict[str, str]:
        """Path of each node of the behaviour tree -> its latest status up to a moment; without one it is left out."""
        return {event.path: event.status for event in self.bundle.trace if event.time_s <= time_s}


def read_playback(workspace: Workspace, status: SessionStatus) -> Playback:
    """The playback of a session that was executed.

    Raises:
        ExecutionError: `EVIDENCE_DAMAGED` where it left no scene model, was thinned, or is damaged.
        DefinitionError: `UNKNOWN_NAME`.
    """
    folder = workspace.evidence_of(status.contract.id)
    if status.execution is None or not (folder / evidence.SCENE_MODEL).is_file():
        message = f"{folder}: no {evidence.SCENE_MODEL}; expected evidence of a session that moved a simulated robot"
        raise ExecutionError("EVIDENCE_DAMAGED", message)
    profile = get_registered_target(workspace.target_registry, status.contract.target)
    try:
        model = read_model(folder / evidence.SCENE_MODEL)
        first, last = (read_arrays(folder / name) for name in (evidence.INITIAL, evidence.TERMINAL))
        moved, course = (
            read_arrays(path) if (path := folder / name).is_file() else {}
            for name in (evidence.MOTION, evidence.TRAJECTORY)
        )
    except (OSError, ValueError, mujoco.FatalError) as error:
        raise ExecutionError("EVIDENCE_DAMAGED", f"{folder}: {error}") from error
    time_s, measured, commanded = (course.get(name, np.empty(0)) for name in ("time_s", "q_measured", "q_commanded"))
    if not moved:
        qpos = np.tile(first["qpos"], (len(time_s), 1))
        for row, q in zip(qpos, measured, strict=True):
            set_posture(model, row, profile, q)
        moved = {"time_s": time_s, "qpos": qpos}
    data = mujoco.MjData(model)
    data.qpos[:] = first["qpos"]
    return Playback(
        model=model,
        time_s=np.concatenate(([float(first["time"])], moved["time_s"], [float(last["time"])])),
        qpos=np.vstack((first["qpos"], moved["qpos"], last["qpos"])),
        measured_m=_trace_tool(model, data, profile, measured),
        planned_m=_trace_tool(model, data, profile, commanded),
        bundle=read_bundle(folder, status.contract, status.execution),
    )


def set_posture(model: mujoco.MjModel, qpos: Array, profile: TargetProfile, q_rad: Sequence[float]) -> None:
    """Put what an arm measures into positions (nq,) of all joints; a base that drives or walks stands upright."""
    prefix, servoed = _find_prefix(model, profile), profile.servoed
    if profile.base is not None:  # its free joint stands for `base_x`, `base_y`, `base_yaw`
        at, half = int(model.joint(f"{prefix}base").qposadr[0]), (q_rad[2] - profile.arm.home_rad[2]) / 2
        qpos[at : at + 2] = q_rad[:2]
        qpos[at + 3 : at + 7] = multiply((np.cos(half), 0.0, 0.0, np.sin(half)), tuple(model.qpos0[at + 3 : at + 7]))
    qpos[[int(model.joint(prefix + name).qposadr[0]) for name in profile.arm.joints[servoed]]] = q_rad[servoed]


def follow_beats(
    model: mujoco.MjModel, data: mujoco.MjData, robots: Mapping[str, TargetProfile], beats: Mapping[str, Heartbeat]
) -> None:
    """Put the robots of one world, by their names, where their latest heartbeats say; the others stay."""
    for name in robots.keys() & beats.keys():
        if beats[name].q_rad:
            set_posture(model, data.qpos, robots[name], beats[name].q_rad)
            set_opening(model, data, robots[name], beats[name].gripper_width_m)


def set_opening(model: mujoco.MjModel, data: mujoco.MjData, profile: TargetProfile, width_m: float) -> None:
    """Share an opening [m] among the fingers that slide; others stay."""
    joints = [model.joint(_find_prefix(model, profile) + name) for name in profile.gripper.joints]
    sliding = [joint for joint in joints if joint.type[0] == mujoco.mjtJoint.mjJNT_SLIDE]
    for joint in sliding:
        data.qpos[joint.qposadr[0]] = width_m / len(sliding)


def find_tool(model: mujoco.MjModel, profile: TargetProfile) -> int:
    """Number of the site of its tool centre point."""
    return int(model.site(_find_prefix(model, profile) + profile.tcp).id)


def _find_prefix(model: mujoco.MjModel, profile: TargetProfile) -> str:
    """Of a robot's names in a model: its own name where it is one of several."""
    several = f"{profile.target}/"
    return several if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, several + profile.tcp) >= 0 else ""


def _trace_tool(model: mujoco.MjModel, data: mujoco.MjData, profile: TargetProfile, q: Array) -> Array:
    places, tool = np.empty((len(q), 3)), find_tool(model, profile)
    for row, posture in enumerate(q):
        set_posture(model, data.qpos, profile, posture)
        mujoco.mj_kinematics(model, data)
        places[row] = data.site_xpos[tool]
    return places
