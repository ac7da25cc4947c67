"""One session for the viewer of Rerun: bodies of the scene over time, the tree and the criteria as logs.

A view, not an archive: Rerun promises to read its files for a few of its versions only. https://rerun.io/docs
"""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from phyagentos.errors import needs_extra
from phyagentos.pictures.playback import Playback
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.session import SessionStatus

TIMELINE = "target_time"


def write_rrd(playback: Playback, status: SessionStatus, to: Path) -> None:
    """Write a session to a file, on the timeline `target_time` [s]; raises DefinitionError `EXTRA_MISSING`."""
    with needs_extra("rerun", "paos export rrd"):
        import rerun
    to.touch()  # an OSError where it cannot be written, which Rerun does not tell
    recording = rerun.RecordingStream("phyagentos", recording_id=status.contract.id)
    recording.save(to)
    model, data = playback.model, mujoco.MjData(playback.model)
    poses = np.empty((len(playback.time_s), model.nbody, 7))
    for row, time_s in enumerate(playback.time_s):
        playback.pose(time_s, data)
        poses[row] = np.hstack((data.xpos, data.xquat[:, [1, 2, 3, 0]]))  # Rerun writes the scalar last
    names = (model.body(number).name or str(number) for number in range(model.nbody))
    paths = [f"world/{rerun.escape_entity_path_part(name)}" for name in names]
    for path, own in zip(paths, poses.swapaxes(0, 1), strict=True):
        columns = rerun.Transform3D.columns(translation=own[:, :3], quaternion=own[:, 3:])
        recording.send_columns(path, [rerun.TimeColumn(TIMELINE, duration=playback.time_s)], columns)
    for number in np.flatnonzero(model.geom_group < 3):  # what MuJoCo shows; shapes for collisions are of other groups
        geom = model.geom(number)
        place = rerun.Transform3D(translation=geom.pos, quaternion=geom.quat[[1, 2, 3, 0]])
        recording.log(f"{paths[geom.bodyid[0]]}/{number}", place, *_make_shape(rerun, model, geom), static=True)
    levels = rerun.TextLogLevel
    for event in playback.bundle.trace:
        recording.set_time(TIMELINE, duration=event.time_s)
        text = f"{event.path} {event.status} {event.code} {event.message}".rstrip()
        recording.log("tree", rerun.TextLog(text, level=levels.WARN if event.status == "FAILURE" else levels.INFO))
    recording.set_time(TIMELINE, duration=playback.time_s[-1])
    for attempt in status.attempts:
        for each in attempt.criteria:
            recording.log("criteria", rerun.TextLog(f"{each.truth}: {each.kind} {each.text}: {each.because}"))
        recording.log("verdict", rerun.TextLog(f"{attempt.verdict}: {attempt.reason}"))
    recording.disconnect()


def _make_shape(rerun: Any, model: mujoco.MjModel, geom: Any) -> tuple[Any, ...]:
    """A geom as Rerun draws it; empty for one without an end."""
    rgba = np.round(255 * (model.mat_rgba[geom.matid[0]] if geom.matid[0] >= 0 else geom.rgba)).astype(np.uint8)
    kinds, kind, (radius, half, _) = mujoco.mjtGeom, mujoco.mjtGeom(geom.type[0]), geom.size
    if kind == kinds.mjGEOM_MESH:
        mesh = model.mesh(geom.dataid[0])
        vertices = model.mesh_vert[mesh.vertadr[0] :][: mesh.vertnum[0]]
        faces = model.mesh_face[mesh.faceadr[0] :][: mesh.facenum[0]]
        return (rerun.Mesh3D(vertex_positions=vertices, triangle_indices=faces, albedo_factor=rgba),)
    span: Fields = {"lengths": [2 * half], "radii": [radius]}
    forms = {
        kinds.mjGEOM_BOX: (rerun.Boxes3D, {"half_sizes": [geom.size]}),
        kinds.mjGEOM_SPHERE: (rerun.Ellipsoids3D, {"half_sizes": [(radius, radius, radius)]}),
        kinds.mjGEOM_ELLIPSOID: (rerun.Ellipsoids3D, {"half_sizes": [geom.size]}),
        kinds.mjGEOM_CYLINDER: (rerun.Cylinders3D, span),
        kinds.mjGEOM_CAPSULE: (rerun.Capsules3D, span | {"translations": [(0.0, 0.0, -half)]}),  # else from the origin
    }
    if kind not in forms:
        return ()
    make, sizes = forms[kind]
    return (make(**sizes, colors=[rgba], fill_mode="solid"),)
