"""Looks of a bundle, made by hand: pictures of any bytes, and what was believed."""

import hashlib
import zipfile

import msgspec

from phyagentos.protocol.sessions.evidence import encode_json
from phyagentos.protocol.sessions.looks import (
    LOOK,
    LOOKS,
    LookEntry,
    LookRole,
    StoredCapture,
    StoredFrame,
    StoredLook,
    read_looks,
)
from phyagentos.protocol.sessions.session import Scene
from phyagentos.protocol.world.environment import Pose, TargetState

STATE = TargetState(q_rad=(), qd_rad_s=(), gripper_width_m=0.0, tcp=Pose())


def keep_look(folder, role, pictures, time_s=0.0, text="", **facts):
    """Add one look to a bundle: a whole picture of 192 x 144 pixels for each camera."""
    frames = tuple(
        StoredFrame(
            camera=camera,
            time_s=time_s,
            width=192,
            height=144,
            window=(0, 0, 192, 144),
            fx=200.0,
            fy=200.0,
            cx=96.0,
            cy=72.0,
            world_T_camera=Pose(),
            picture=f"0-{camera}.png",
            depth=f"0-{camera}.npy",
        )
        for camera in pictures
    )
    scene = Scene(name="s", seed=1, episode="e")
    captures = (StoredCapture(frames=frames),)
    look = StoredLook(target="arm", scene=scene, before=None, things=(), now=(time_s, STATE), captures=captures)
    path = folder / f"look-{role}.zip"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr(LOOK, msgspec.json.encode(look))
        for camera, png in pictures.items():
            file.writestr(f"0-{camera}.png", png)
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    entry = LookEntry(file=path.name, sha256=sha256, role=LookRole(role), time_s=time_s, text=text, **facts)
    (folder / LOOKS).write_bytes(encode_json([*read_looks(folder), entry]))
    return entry
