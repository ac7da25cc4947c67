"""A look as one zip file: pictures as PNG, depths as `.npy`, the rest as JSON; no bit is lost.

Upstream: the recorder. Downstream: perception, which answers from it again. The bytes depend on the look alone.
"""

import hashlib
import io
import zipfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.looks import LOOK, PREFIX, StoredCapture, StoredFrame, StoredLook, read_stored_look
from phyagentos.runtime.perception.look import Look, get_window
from phyagentos.runtime.targets.wire import Capture, Frame, Frames

_LEVEL = 1  # of deflate: more costs three times the time for a tenth of the size


def write_look(look: Look, folder: Path) -> tuple[str, str]:
    """Let a bundle hold a look; one that another bundle holds already is linked.

    Args:
        look: It remembers where it was written.
        folder: Of the bundle.

    Returns:
        Name of the file and SHA-256 of its bytes.
    """
    if look.file is not None:
        known, sha256 = look.file
        if not (path := folder / known.name).exists():
            try:
                path.hardlink_to(known)
            except OSError:  # it was pruned, lies on another disk, or has too many links
                path.write_bytes(_encode(look))
        return known.name, sha256
    data = _encode(look)
    sha256 = hashlib.sha256(data).hexdigest()
    path = folder / f"{PREFIX}{sha256[:16]}.zip"
    path.write_bytes(data)
    look.file = path, sha256
    return path.name, sha256


def read_look(path: Path, sha256: str) -> Look:
    """A look as it was recorded.

    Raises:
        ExecutionError: `LOOK_MISSING` or `EVIDENCE_UNREADABLE`, which name the file.
    """
    stored = read_stored_look(path, sha256)
    with zipfile.ZipFile(path) as file:
        captures = [(_make_request(each), _read_frames(each, file)) for each in stored.captures]
    return Look(
        target=stored.target,
        scene=stored.scene,
        before=stored.before,
        things=frozenset(stored.things),
        now=stored.now,
        captures=captures,
        moments=list(stored.moments),
        states=list(stored.states),
        file=(path, sha256),
    )


def _encode(look: Look) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:
        captures = [
            StoredCapture(
                cameras=asked.cameras,
                crops=asked.crops,
                every=asked.every,
                frames=tuple(_write_frames(number, asked, frames, file)),
                missing=frames.missing,
            )
            for number, (asked, frames) in enumerate(look.captures)
        ]
        stored = StoredLook(
            target=look.target,
            scene=look.scene,
            before=look.before,
            things=tuple(sorted(look.things)),
            now=look.now,
            captures=tuple(captures),
            moments=tuple(look.moments),
            states=tuple(look.states),
        )
        file.writestr(zipfile.ZipInfo(LOOK), msgspec.json.encode(stored), zipfile.ZIP_DEFLATED, _LEVEL)
    return buffer.getvalue()


def _write_frames(number: int, asked: Capture, frames: Frames, file: zipfile.ZipFile) -> Iterator[StoredFrame]:
    for frame in frames.frames:
        name = f"{number}-{frame.camera}"
        done, png = cv2.imencode(".png", np.ascontiguousarray(frame.rgb[..., ::-1]))
        if not done:
            raise ExecutionError("EVIDENCE_UNWRITABLE", f"the picture of {frame.camera} cannot be encoded as PNG")
        file.writestr(zipfile.ZipInfo(f"{name}.png"), png.tobytes())
        depth = io.BytesIO()
        np.save(depth, frame.depth_m)
        file.writestr(zipfile.ZipInfo(f"{name}.npy"), depth.getvalue(), zipfile.ZIP_DEFLATED, _LEVEL)
        yield StoredFrame(
            camera=frame.camera,
            time_s=frame.time_s,
            width=frame.width,
            height=frame.height,
            window=get_window(asked, frame),
            fx=frame.fx,
            fy=frame.fy,
            cx=frame.cx,
            cy=frame.cy,
            world_T_camera=frame.world_T_camera,
            picture=f"{name}.png",
            depth=f"{name}.npy",
        )


def _make_request(capture: StoredCapture) -> Capture:
    return Capture(cameras=capture.cameras, crops=capture.crops, every=capture.every)


def _read_frames(capture: StoredCapture, file: zipfile.ZipFile) -> Frames:
    frames = tuple(
        Frame(
            camera=each.camera,
            time_s=each.time_s,
            width=each.width,
            height=each.height,
            fx=each.fx,
            fy=each.fy,
            cx=each.cx,
            cy=each.cy,
            world_T_camera=each.world_T_camera,
            rgb=_read_picture(file.read(each.picture)),
            depth_m=np.load(io.BytesIO(file.read(each.depth))),
        )
        for each in capture.frames
    )
    return Frames(frames, capture.missing)


def _read_picture(png: bytes) -> NDArray[np.uint8]:
    decoded = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    if decoded is None:
        raise ExecutionError("EVIDENCE_UNREADABLE", "a picture of a look is no PNG")
    return np.ascontiguousarray(decoded[..., ::-1], dtype=np.uint8)
