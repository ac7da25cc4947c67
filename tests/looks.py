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
    StoredFrame,
    StoredFrames,
    StoredLook,
    StoredRequest,
    read_looks,
)


def keep_look(folder, role, pictures, time_s=0.0, text="", **facts):
    """Add one look to a bundle: a whole picture of 192 x 144 pixels for each camera."""
    frames = tuple(
        StoredFrame(
            camera=camera, time_s=time_s, width=192, height=144, rgb=f"0-{camera}.png", depth_m=f"0-{camera}.npy"
        )
        for camera in pictures
    )
    look = StoredLook(phy="look/1", captures=((StoredRequest(), StoredFrames(frames=frames)),))
    path = folder / f"look-{role}.zip"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr(LOOK, msgspec.json.encode(look))
        for camera, png in pictures.items():
            file.writestr(f"0-{camera}.png", png)
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    entry = LookEntry(file=path.name, sha256=sha256, role=LookRole(role), time_s=time_s, text=text, **facts)
    (folder / LOOKS).write_bytes(encode_json([*read_looks(folder), entry]))
    return entry
