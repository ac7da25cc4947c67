"""The port of the kit: what a person writes to serve a body. `served` adds authority, limits, receive log and stops."""

import json
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from target_server.procedures import Call, Procedure
from target_server.wire import Refusal

OUTCOMES = "PHYAGENTOS_OUTCOMES"  # names a file, where who starts a body measures it
Triple = tuple[float, float, float]
Window = tuple[int, int, int, int]  # left, top, width and height [pixels]


@dataclass(frozen=True)
class Joint:
    """One joint, in the order in which joints are commanded.

    Attributes:
        low: Least position [rad or m]; `high` the greatest. Set-points outside are refused.
        velocity: Greatest speed of set-points [rad/s or m/s].
        axis: (3,) along which it slides or about which it turns, in the world, with all joints at zero; zeros for one
            that does not move the tool.
        anchor_m: (3,) a point on this axis [m].
        slides: Whether it slides.
    """

    name: str
    low: float
    high: float
    velocity: float = float("inf")
    axis: Triple = (0.0, 0.0, 0.0)
    anchor_m: Triple = (0.0, 0.0, 0.0)
    slides: bool = True


@dataclass(frozen=True)
class State:
    """What a body senses of itself.

    Attributes:
        q: (n_joints,) positions, `qd` velocities.
        tcp_m: (3,) where the tool is, in the world [m]; `tcp_wxyz` how it is turned.
        width_m: Opening of its gripper [m].
        holding: Names of the objects that its gripper holds, where it can tell.
        fingers_touching: How many of its fingers touch something that is none of them, where it has sensors of touch.
        grip_force_n: Force that presses its fingers together, by their motor [N]; None where it is not measured.
        base: Where it stands, x and y [m], and its heading [rad]; None where it is fixed.
        inventory: What it carries, by kind of item, each at least 1; None where it reports none of these four.
        vitals: How well it is, by name (`health`, `food`).
        nearby: Kinds of the places in its reach at which something is made.
        daylight: How light it is where it is, 0..1.
    """

    q: Sequence[float] = ()
    qd: Sequence[float] = ()
    tcp_m: Triple = (0.0, 0.0, 0.0)
    tcp_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    width_m: float = 0.0
    holding: Sequence[str] = ()
    fingers_touching: int = 0
    grip_force_n: float | None = None
    base: Triple | None = None
    inventory: Mapping[str, int] | None = None
    vitals: Mapping[str, float] | None = None
    nearby: Sequence[str] | None = None
    daylight: float | None = None


@dataclass(frozen=True)
class Picture:
    """What an RGB-D camera sees: pixel (u, v) with depth z lies at z ((u - cx) / fx, (v - cy) / fy, 1) in its frame.

    Attributes:
        time_s: When it was exposed.
        focal_px: fx and fy; `center_px` cx and cy.
        position_m: (3,) of the camera in the world; `quaternion_wxyz` turns its axes, z forward, x right, y down.
        rgb: (height, width, 3) bytes, row by row.
        depth_m: (height, width) along z [m], little-endian float32; NaN where nothing was measured.
    """

    camera: str
    time_s: float
    width: int
    height: int
    focal_px: tuple[float, float]
    center_px: tuple[float, float]
    position_m: Triple
    quaternion_wxyz: tuple[float, float, float, float]
    rgb: bytes
    depth_m: bytes

    def encode(self) -> dict[str, Any]:
        """As the wire has it."""
        (fx, fy), (cx, cy), size = self.focal_px, self.center_px, [self.height, self.width]
        pose = {"position_m": self.position_m, "quaternion_wxyz": self.quaternion_wxyz}
        return {
            "camera": self.camera, "time_s": self.time_s, "width": self.width, "height": self.height,
            "fx": fx, "fy": fy, "cx": cx, "cy": cy, "world_T_camera": pose,
            "rgb": {"shape": [*size, 3], "u1": self.rgb}, "depth_m": {"shape": size, "f4": self.depth_m},
        }  # fmt: skip


@dataclass(frozen=True)
class Entity:
    """An object as the body's simulation knows it.

    Attributes:
        shapes: Maps with `kind` (`box`, `sphere`, `cylinder`, `capsule`), `size_m`, its half extents, and `pose`.
        more: Further fields of an entity, as the framework names them: `joint`, `mechanism`, `interior`, `part_of`.
    """

    name: str
    kind: str
    position_m: Triple
    quaternion_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    movable: bool = True
    shapes: Sequence[Mapping[str, Any]] = ()
    more: Mapping[str, Any] = field(default_factory=dict)

    def encode(self) -> dict[str, Any]:
        """As the wire has it."""
        return {
            "name": self.name, "kind": self.kind, "movable": self.movable, "shapes": list(self.shapes),
            "pose": {"position_m": self.position_m, "quaternion_wxyz": self.quaternion_wxyz}, **self.more,
        }  # fmt: skip


class Body(ABC):
    """One body. Calls come one at a time, from one thread.

    A method refuses by `wire.Refusal` with a code; nothing has moved then.

    Attributes:
        target: Its name, as in target.yaml of the framework's side; `joints`, `step_s` and `steps_per_command` as well.
        step_s: What one `step` takes of the body's time [s].
        tcp_m: (3,) the tool with all joints at zero [m].
        width_max_m: Widest opening of its gripper [m].
        is_realtime: Whether its time goes on by itself; without a command in time it is halted then (`DEADMAN`).
        has_truth: Whether `list_entities` says where objects are.
        cameras: Names of its RGB-D cameras, as in sensors.yaml of the framework's side.
        procedures: What it does by itself when `call` starts it, while set-points hold its joints still.
        tools: By name; each takes its arguments and gives (media type, bytes) by file name. None moves the body.
        beat: Call it during what takes long: the other side waits on.
    """

    target: str
    joints: Sequence[Joint]
    step_s: float
    steps_per_command: int = 1
    driver: str = "kit"
    observations: Sequence[str] = ("joint_state",)
    actions: Sequence[str] = ("joint_position",)
    tcp_m: Triple = (0.0, 0.0, 0.0)
    end_effector: str = "none"
    gripper_force_n: float = 0.0
    width_max_m: float = 0.0
    is_realtime: bool = False
    has_truth: bool = False
    cameras: Sequence[str] = ()
    procedures: Sequence[Procedure] = ()
    tools: Mapping[str, Callable[[Mapping[str, Any]], Mapping[str, tuple[str, bytes]]]] = {}
    beat: Callable[[], None] = staticmethod(lambda: None)

    @property
    @abstractmethod
    def time_s(self) -> float:
        """Time of the body [s]."""

    def measure_silence(self, silent_s: float) -> float:
        """In time of the body [s], how long it has had no command, of seconds of this machine's clock."""
        return silent_s

    @abstractmethod
    def load(self, scene: str, seed: int, snapshot: bytes) -> None:
        """Begin an episode, from a snapshot where it is not empty."""

    @abstractmethod
    def read(self) -> State:
        """The present."""

    def list_entities(self) -> Sequence[Entity]:
        """The ground truth of objects, where `has_truth`."""
        return ()

    def list_regions(self) -> Sequence[Mapping[str, Any]]:
        """Boxes of space that have names: `name`, `pose` and `half_m` [m], where `has_truth`."""
        return ()

    def list_signals(self) -> Mapping[str, Sequence[float]]:
        """Further measurements by the names of `observations`, flattened; where `has_truth`, with that alone."""
        return {}

    def capture(self, cameras: Sequence[str], windows: Mapping[str, Window], every: int) -> Sequence[Picture]:
        """What these cameras see now, all of them where none is named; no time passes.

        Args:
            cameras: Names.
            windows: Parts of whole pictures by camera; what is not in a window need not be drawn.
            every: Of so many rows and columns the middle one is read, odd.
        """
        if cameras or windows:
            raise Refusal("REQUEST_INVALID", "the target has no cameras")
        return ()

    def measure_error(self, wanted: Sequence[float]) -> float:
        """How far it is behind set-points (n_joints,), as the greatest angle of a joint [rad]."""
        return max((abs(q - each) for q, each in zip(self.read().q, wanted, strict=True)), default=0.0)

    @abstractmethod
    def step(self, q: Sequence[float], qd: Sequence[float], width_m: float) -> str:
        """Take one row of set-points; `step_s` has passed then.

        Returns:
            Code of the body's own protective stop, after which it is at rest; empty otherwise.
        """

    def call(self, procedure: str, goal: Mapping[str, Any]) -> Call:
        """Start one of `procedures` with values by path; never waits. Stops and the session's end cancel it.

        Raises:
            Refusal: `REQUEST_INVALID` for a path or value that does not fit; nothing was started.
        """
        raise Refusal("REQUEST_INVALID", f"the target has no procedure {procedure!r}")

    @abstractmethod
    def stay(self) -> None:
        """Hold still where it is; `step_s` has passed then."""

    @abstractmethod
    def halt(self, category: int) -> None:
        """Come to rest within the limits, by its own means."""

    def emergency_stop(self) -> None:
        """The emergency stop is pressed: come to rest, by the device's own stop where it has one.

        A stop of category 1 (IEC 60204-1, 9.2.2) where a body says nothing else: never 2, which keeps the drives on.
        """
        self.halt(1)

    def snapshot(self) -> tuple[str, bytes] | None:
        """Media type and whole state, from which `load` goes on with the same bits; None where there is no such."""
        return None

    def note_end(self, session: str) -> None:  # noqa: B027 - not every body needs it
        """A session has ended; the body is at rest. What is measured of it goes through `append_outcome`."""

    def close(self) -> None:  # noqa: B027 - not every body needs it
        """Close devices."""


def append_outcome(session: str, **says: Any) -> None:
    """A line of what an environment says of success, to the file of who measures; the agent never reads it."""
    if path := os.environ.get(OUTCOMES):
        with Path(path).open("a", encoding="utf-8") as file:
            file.write(json.dumps({"session": session, **says}) + "\n")
