"""The looks of a session in its evidence bundle: pictures, depths, the belief before, the robot's state.

A look is one zip file `look-<hash>.zip`, readable without this package: a PNG and an array of depths for each picture,
and `look.json`, which describes them. `looks.json` names the looks of a session and the purpose of each.
"""

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import msgspec

from phyagentos.errors import ExecutionError, Problem
from phyagentos.geometry import Pose
from phyagentos.protocol.documents.packed_files import open_packed
from phyagentos.protocol.documents.regular_files import hash_regular
from phyagentos.protocol.sessions.evidence_manifest import FileName, read_part
from phyagentos.protocol.world.environment import Environment

LOOKS = "looks.json"  # list of LookEntry
LOOK = "look.json"  # within a look's file
FORMAT = "look/1"
PREFIX = "look-"
TIME_TOLERANCE_S = 0.00051  # times in pointers are rounded to the millisecond

Window = tuple[int, int, int, int]
"""Left, top, width, height [pixels] of a camera's whole picture."""


class LookRole(StrEnum):
    """Purpose of a look."""

    START = "start"
    """The world before the first command."""
    LOOK = "look"
    """A skill looked at everything."""
    END = "end"
    """The world at rest after the last command."""
    WORST = "worst"
    """The worst sample of a hold condition."""
    UNKNOWN = "unknown"
    """The first sample of a hold condition that was unknown."""
    POINTED = "pointed"
    """A snapshot points at one of its pictures."""


class LookEntry(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One look of a session.

    Attributes:
        file: Within the bundle.
        time_s: Of the request, in the target's time [s].
        text: The hold condition of a sample.
        metrics: Measurements of the target at that time, for a hold condition that reads them.
    """

    file: FileName
    sha256: str
    role: LookRole
    time_s: float
    text: str = ""
    metrics: dict[str, float] = {}


class StoredFrame(msgspec.Struct, frozen=True, kw_only=True):
    """One picture with depth; pixel (u, v) with depth z is the point z * ((u - cx) / fx, (v - cy) / fy, 1).

    Attributes:
        time_s: Stamp of the sensor [s].
        fx, fy, cx, cy: Focal lengths and principal point [pixels], 0 where not recorded; the first pixel's middle is at
            (0.5, 0.5).
        world_T_camera: OpenCV's convention: z forward, x right, y down.
        rgb: Name of the PNG.
        depth_m: Name of the `.npy`, float32 (height, width) along z; NaN where nothing was measured.
    """

    camera: str
    time_s: float
    width: int
    height: int
    fx: float = 0.0
    fy: float = 0.0
    cx: float = 0.0
    cy: float = 0.0
    world_T_camera: Pose = Pose()
    rgb: str
    depth_m: str


class StoredRequest(msgspec.Struct, frozen=True, kw_only=True):
    """A request to the cameras: windows by camera; one of `every` rows and columns is read out."""

    crops: dict[str, Window] = {}
    every: int = 1


class StoredFrames(msgspec.Struct, frozen=True, kw_only=True):
    """Answer of the cameras."""

    frames: tuple[StoredFrame, ...] = ()


class StoredLook(msgspec.Struct, frozen=True, kw_only=True):
    """The part of `look.json` that is read without perception: requests and pictures."""

    phy: str
    captures: tuple[tuple[StoredRequest, StoredFrames], ...] = ()


@dataclass(frozen=True, slots=True)
class Pointer:
    """Where an object was seen: left, top, width and height in pixels of a whole picture, and the stamp of that [s]."""

    camera: str
    time_s: float
    window: Window

    def __str__(self) -> str:
        """`camera@time:left,top,width,height`."""
        return f"{self.picture}:{','.join(map(str, self.window))}"

    @classmethod
    def parse(cls, text: str) -> "Pointer | None":
        """The pointer of a text; None of one that names no pixels."""
        picture, _, pixels = text.partition(":")
        camera, _, stamp = picture.partition("@")
        try:
            left, top, width, height = map(int, pixels.split(","))
            return cls(camera, float(stamp), (left, top, width, height))
        except ValueError:
            return None

    @classmethod
    def parse_all(cls, texts: Iterable[str]) -> "list[Pointer]":
        """Those of the texts that name pixels."""
        return [pointer for text in texts if (pointer := cls.parse(text)) is not None]

    @property
    def picture(self) -> str:
        """The picture, as `name_picture` does."""
        return name_picture(self.camera, self.time_s)

    @property
    def area_px(self) -> int:
        """Pixels of the window."""
        return self.window[2] * self.window[3]


def name_picture(camera: str, time_s: float) -> str:
    """`camera@time` of a picture, in milliseconds."""
    return f"{camera}@{time_s:.3f}"


def shows(captures: Iterable[tuple[Any, Any]], pointer: Pointer | None) -> bool:
    """Whether a picture holds all pixels of a pointer; a thinned one, as far as its rows and columns reach.

    Args:
        captures: Requests (`crops`, `every`) and answers (`frames`) of the cameras, as recorded or as they are read.
        pointer: None shows nowhere.
    """
    if pointer is None:
        return False
    left, top, width, height = pointer.window
    for request, answer in captures:
        slack = request.every - 1
        for frame in answer.frames:
            x, y, columns, rows = request.crops.get(frame.camera, (0, 0, frame.width, frame.height))
            is_same = frame.camera == pointer.camera and abs(pointer.time_s - frame.time_s) < TIME_TOLERANCE_S
            is_within = x - slack <= left and left + width <= x + columns + slack
            if is_same and is_within and y - slack <= top and top + height <= y + rows + slack:
                return True
    return False


def read_looks(folder: Path) -> tuple[LookEntry, ...]:
    """The looks that a bundle names, empty without any; raises ExecutionError `EVIDENCE_DAMAGED`."""
    return read_part(folder / LOOKS, tuple[LookEntry, ...]) or ()


def read_stored_look(path: Path, sha256: str = "") -> StoredLook:
    """A look's file without its pixels; its bytes must have `sha256`, if given.

    Raises:
        ExecutionError: `EVIDENCE_DAMAGED`, which name the file.
    """
    try:
        if sha256 and hash_regular(path) != sha256:
            raise ExecutionError("EVIDENCE_DAMAGED", f"{path}: its bytes are not those of sha256 {sha256}")
        with open_packed(path) as file:
            return msgspec.json.decode(file.read(LOOK), type=StoredLook)
    except FileNotFoundError as error:
        raise ExecutionError("EVIDENCE_DAMAGED", f"no file {path}; expected the look of sha256 {sha256}") from error
    except (KeyError, ValueError, msgspec.MsgspecError, OSError) as error:
        raise ExecutionError("EVIDENCE_DAMAGED", f"{path}: {error}") from error


def iter_whole_frames(folder: Path) -> Iterator[tuple[LookEntry, StoredFrame]]:
    """The whole pictures of a bundle, in the order of its looks; raises as `read_looks` and `read_stored_look`."""
    for entry in read_looks(folder):
        for request, answer in read_stored_look(folder / entry.file).captures:
            for frame in () if request.crops else answer.frames:
                yield entry, frame


def read_pictures(folder: Path, role: LookRole) -> tuple[str, tuple[bytes, ...]]:
    """The file of a look and its whole pictures as PNG, one a camera; raises as `read_stored_look`."""
    entry = next((each for each in read_looks(folder) if each.role is role), None)
    if entry is None:
        raise ExecutionError("EVIDENCE_DAMAGED", f"{folder}: no camera picture of the {role}")
    look = read_stored_look(folder / entry.file, entry.sha256)
    whole = [frame for asked, given in look.captures if not asked.crops for frame in given.frames]
    return entry.file, tuple(read_picture(folder / entry.file, frame.rgb) for frame in whole)


def read_picture(look: Path, name: str) -> bytes:
    """A picture of a look's file as PNG; raises ExecutionError `EVIDENCE_DAMAGED`."""
    try:
        with open_packed(look) as file:
            return file.read(name)
    except (KeyError, ValueError, OSError) as error:
        raise ExecutionError("EVIDENCE_DAMAGED", f"{look}: {error}") from error


def find_look_problems(folder: Path, worlds: Iterable[Environment], gone: Collection[str] = ()) -> list[Problem]:
    """Looks that a bundle names and lacks, and pointers of its snapshots to pixels that no look holds.

    Looks whose files a clean-up took out (`gone`) are not missed.
    """
    looks: list[StoredLook] = []
    problems: list[Problem] = []
    entries = read_looks(folder)
    for name in dict.fromkeys(entry.file for entry in entries if entry.file not in gone):
        try:
            looks.append(read_stored_look(folder / name))
        except ExecutionError as error:
            problems.append(Problem(error.code, str(folder / name), str(error)))
    if not entries or problems or any(entry.file in gone for entry in entries):
        return problems
    return [
        Problem("EVIDENCE_DAMAGED", f"{folder}: {entity.name}", pointer, "pixels that a look of this bundle holds")
        for world in worlds
        for entity in world.entities.values()
        for pointer in entity.evidence
        if not any(shows(look.captures, Pointer.parse(pointer)) for look in looks)
    ]
