"""One session for the viewer of Rerun: bodies of the scene over time, the tree and the criteria as logs.

A view, not an archive: Rerun promises to read its files for a few of its versions only. https://rerun.io/docs
"""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from phyagentos.errors import needs_extra
from phyagentos.pictures.playback import Playback
from phyagentos.protocol.sessions.session import SessionStatus

TIMELINE = "target_time"
_SHOWN_GROUPS = 3  # MuJoCo shows the first three groups of geoms; shapes for collisions stand behind them


def write_rrd(playback: Playback, status: SessionStatus, to: Path) -> None:
    """Write a session to a file, on the timeline `target_time` [s]; raises DefinitionError `EXTRA_MISSING`."""
    with needs_extra("rerun", "paos export rrd"):
        import rerun
    recording = rerun.RecordingStream("phyagentos", recording_id=status.contract.id)
    recording.save(to)
    model, data = playback.model, mujoco.MjData(playback.model)
    poses = np.empty((len(playback.time_s), model.nbody, 7))
    for row, time_s in enumerate(playback.time_s):
        playback.pose(time_s, data)
        poses[row] = np.hstack((data.xpos, data.xquat[:, [1, 2, 3, 0]]))  # Rerun writes the scalar last
    for body in range(model.nbody):
        path, own = f"world/{model.body(body).name or body}", poses[:, body]
        columns = rerun.Transform3D.columns(translation=own[:, :3], quaternion=own[:, 3:])
        recording.send_columns(path, [rerun.TimeColumn(TIMELINE, duration=playback.time_s)], columns)
    for number in np.flatnonzero(model.geom_group < _SHOWN_GROUPS):
        geom = model.geom(number)
        if (shape := _make_shape(rerun, model, geom)) is not None:
            path = f"world/{model.body(geom.bodyid[0]).name or geom.bodyid[0]}/{number}"
            place = rerun.Transform3D(translation=geom.pos, quaternion=geom.quat[[1, 2, 3, 0]])
            recording.log(path, place, shape, static=True)
    for event in playback.bundle.trace:
        recording.set_time(TIMELINE, duration=event.time_s)
        level = "WARN" if event.status == "FAILURE" else "INFO"
        text = f"{event.path} {event.status} {event.code} {event.message}".rstrip()
        recording.log("tree", rerun.TextLog(text, level=level))
    recording.set_time(TIMELINE, duration=playback.time_s[-1])
    for attempt in status.attempts:
        recording.log("verdict", rerun.TextLog(f"{attempt.verdict}: {attempt.reason}", level="INFO"))
        for each in attempt.criteria:
            recording.log("verdict/criteria", rerun.TextLog(f"{each.truth}: {each.kind} {each.text}: {each.because}"))
    recording.flush()
    recording.disconnect()


def _make_shape(rerun: Any, model: mujoco.MjModel, geom: Any) -> Any:
    """A geom as Rerun draws it, None of one without an end."""
    rgba = model.mat_rgba[geom.matid[0]] if geom.matid[0] >= 0 else geom.rgba
    colors = [np.round(255 * rgba).astype(np.uint8)]
    solid = {"colors": colors, "fill_mode": "solid"}
    radius, half, _ = geom.size
    match mujoco.mjtGeom(geom.type[0]):
        case mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.mesh(geom.dataid[0])
            return rerun.Mesh3D(
                vertex_positions=model.mesh_vert[mesh.vertadr[0] :][: mesh.vertnum[0]],
                triangle_indices=model.mesh_face[mesh.faceadr[0] :][: mesh.facenum[0]],
                albedo_factor=colors[0],
            )
        case mujoco.mjtGeom.mjGEOM_BOX:
            return rerun.Boxes3D(half_sizes=[geom.size], **solid)
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            return rerun.Ellipsoids3D(half_sizes=[(radius, radius, radius)], **solid)
        case mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            return rerun.Ellipsoids3D(half_sizes=[geom.size], **solid)
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            return rerun.Cylinders3D(lengths=[2 * half], radii=[radius], **solid)
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            return rerun.Capsules3D(lengths=[2 * half], radii=[radius], translations=[(0, 0, -half)], **solid)
        case _:
            return None
