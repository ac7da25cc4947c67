"""The messages between a worker and a target: msgpack, one request, one reply, in order. No simulator is presumed.

Arrays travel in C order with their shape: float64, pictures as uint8, depth as float32. What only a driver can read
(its state, a compiled model) travels as bytes with a media type. `handshake` opens a connection, `server` answers.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import ExecutionError
from phyagentos.protocol.world.environment import Entity, Pose, Region, TargetState
from phyagentos.runtime.channel import Channel, Codec
from phyagentos.runtime.targets import handshake

Array = NDArray[np.float64]
Colours = NDArray[np.uint8]
Depths = NDArray[np.float32]
Crop = tuple[int, int, int, int]  # left, top, width, height [pixels]
WAIT_SLICE_S = 0.2  # a client that waits long shows its life this often
WIRE_VERSION = handshake.WIRE_VERSION
NPZ = "application/x-npz"
RENDER = "render"  # tool: a picture for people; arguments `camera`, `width`, `height`; artefact `picture.png`
SCENE_MODEL = "scene_model"  # tool: the compiled scene, artefacts by file name


class Artefact(msgspec.Struct, frozen=True):
    """Bytes that a driver made, and what they are.

    Attributes:
        media_type: As in MIME (`application/x-npz`, `image/png`).
    """

    media_type: str
    data: bytes


class Describe(msgspec.Struct, frozen=True, tag=True):
    """Ask what the target is. Reply: `Description`."""


class LoadScene(msgspec.Struct, frozen=True, tag=True):
    """Begin an episode: build the scene, place the target at home, let things settle. Reply: `Loaded`.

    The only moment at which simulator state is written. Refused for an episode that is already loaded with another
    scene or seed; a no-op for the one that is.

    Attributes:
        snapshot: The driver's own snapshot to start from (rerun of a recorded session); empty for a fresh start.
        may_reset: Whether the world in which another episode stands may be begun anew. Else it is refused.
    """

    scene: str
    seed: int
    episode: str
    snapshot: bytes = b""
    may_reset: bool = True


class Begin(msgspec.Struct, frozen=True, tag=True):
    """Give one session authority over the target. Reply: `Ack`.

    Attributes:
        epoch: Fencing token; a smaller one than any seen before is refused.
    """

    session: str
    epoch: int


class Command(msgspec.Struct, frozen=True, tag=True):
    """One control period of set-points. Reply: `Step`.

    Attributes:
        q_rad: (n_steps, n_joints) joint position set-points, one row per physics step.
        qd_rad_s: (n_steps, n_joints) joint velocity set-points.
        gripper_width_m: (n_steps,) opening set-points.
        sequence: Grows by one per command of a session.
        expires_at_s: Simulated time after which the command must not be carried out.
    """

    session: str
    epoch: int
    sequence: int
    expires_at_s: float
    q_rad: Array
    qd_rad_s: Array
    gripper_width_m: Array


class Halt(msgspec.Struct, frozen=True, tag=True):
    """Bring the target to rest within its limits, by its own means, and hold. Reply: `Step`.

    Attributes:
        category: Of the stop (IEC 60204-1, 9.2.2): after 2 the session may command again; after 1 it may not, and the
            target holds until another session begins.
    """

    session: str
    epoch: int
    category: int = 2


class Settle(msgspec.Struct, frozen=True, tag=True):
    """Hold still for some simulated time. Reply: `Step`."""

    session: str
    epoch: int
    duration_s: float


class End(msgspec.Struct, frozen=True, tag=True):
    """Take authority back: no later command of this session is accepted. Reply: `Ended`."""

    session: str
    epoch: int


class Observe(msgspec.Struct, frozen=True, tag=True):
    """Ask for an observation without moving time. Reply: `Observation`.

    Attributes:
        truth: With the ground truth of things and regions; refused where it is not offered (`NO_GROUND_TRUTH`).
        snapshot: With the driver's snapshot of the same moment.
    """

    truth: bool = False
    snapshot: bool = False


class InvokeTool(msgspec.Struct, frozen=True, tag=True):
    """Use a tool of the description. Reply: `ToolResult`.

    Attributes:
        arguments: As the tool takes them.
        session: Needed, with its epoch, for a tool that moves something.
    """

    name: str
    arguments: dict[str, Any] = {}
    session: str = ""
    epoch: int = 0


class Capture(msgspec.Struct, frozen=True, tag=True):
    """Ask RGB-D cameras for their latest frames without moving time. Reply: `Frames`.

    Attributes:
        cameras: Names of sensors.yaml; empty for all.
        crops: Windows to look at instead of the whole picture, by camera: a small one is cheap enough for 10 Hz.
        every: Of so many rows and columns only the middle one is read out; odd. 1 for all.
    """

    cameras: tuple[str, ...] = ()
    crops: dict[str, Crop] = {}
    every: int = 1


class Shutdown(msgspec.Struct, frozen=True, tag=True):
    """End the process. Reply: `Ack`."""


class Ack(msgspec.Struct, frozen=True, tag=True):
    """Done."""


class Refused(msgspec.Struct, frozen=True, tag=True):
    """Not done; nothing moved.

    Attributes:
        code: `STALE_TOKEN`, `NO_AUTHORITY`, `OUT_OF_SEQUENCE`, `EXPIRED`, `MALFORMED`, `TARGET_LIMIT`, ...
    """

    code: str
    message: str


class Kinematics(msgspec.Struct, frozen=True):
    """A chain of hinges and slides as it stands at joint positions zero, in the world frame.

    Attributes:
        axes: (n_joints, 3) unit vectors that the joints turn about or slide along; zero for a slide without effect.
        anchors_m: (n_joints, 3) a point on each axis.
        tcp_m: (3,) the tool centre point.
        slides: (n_joints,) which joints slide; empty when all turn.
    """

    axes: tuple[tuple[float, float, float], ...]
    anchors_m: tuple[tuple[float, float, float], ...]
    tcp_m: tuple[float, float, float]
    slides: tuple[bool, ...] = ()


class Tool(msgspec.Struct, frozen=True):
    """Something that a target does besides moving along set-points.

    Attributes:
        moves: Whether it moves something, so that it needs authority.
    """

    name: str
    moves: bool = False


class Description(msgspec.Struct, frozen=True, tag=True):
    """What the target is, read from the live model rather than from its profile.

    What a target leaves out has no default that would pass: preflight refuses it, and the guard every command.

    Attributes:
        kinematics: Where the joints bring the tool centre point; None when not told.
        gripper_force_n: The most that a finger can press with, 0 for one that cannot press; NaN when not told.
        joints: In the order in which they are commanded; empty when not told.
        depth_cameras: Those that `Capture` can ask: the cameras of sensors.yaml that this scene or robot has.
        version: Of the wire that the target speaks; 0 when not told.
        driver: What moves it, by its name in the registry; a relay puts its own before it (`remote/mujoco`).
        tools: What `InvokeTool` may ask for.
        ground_truth: Whether `Observe` may ask for the ground truth.
        shares_time: Whether other targets move in the same simulated time, so that a motion may wait for theirs.
        end_effector: What the tool flange carries: `opening`, `suction` or `none`.
    """

    target: str
    n_joints: int
    steps_per_command: int
    physics_step_s: float
    q_min_rad: tuple[float, ...]
    q_max_rad: tuple[float, ...]
    observations: tuple[str, ...]
    actions: tuple[str, ...]
    cameras: tuple[str, ...]
    mode: str
    kinematics: Kinematics | None = None
    gripper_force_n: float = math.nan
    joints: tuple[str, ...] = ()
    depth_cameras: tuple[str, ...] = ()
    version: int = 0
    driver: str = ""
    tools: tuple[Tool, ...] = ()
    ground_truth: bool = False
    shares_time: bool = False
    end_effector: str = "opening"

    def offers_tool(self, name: str) -> bool:
        """Whether there is a tool of this name."""
        return any(tool.name == name for tool in self.tools)


class Loaded(msgspec.Struct, frozen=True, tag=True):
    """The episode's world stands.

    Attributes:
        model_sha256: Hash of the compiled model, to compare with a recorded one; empty without a model.
    """

    episode: str
    model_sha256: str


class Step(msgspec.Struct, frozen=True, tag=True):
    """The world after one command: what a tick of a tree needs.

    Attributes:
        time_s: Simulated time.
        target: The target's own state.
        tracking_error_rad: Largest |q - q_d| at the end of the period.
        stopped: Code of the target's own protective stop, when the command was broken off; the target has come to rest
            and takes no further command of this session.
        contact_force_n: The greatest force between the robot and one other body since the latest report, as its joint
            torque sensors feel it; None where it cannot feel.
    """

    time_s: float
    target: TargetState
    tracking_error_rad: float
    stopped: str = ""
    contact_force_n: float | None = None


class Observation(msgspec.Struct, frozen=True, tag=True):
    """What the target senses of itself at one moment, before perception.

    Attributes:
        entities: Ground truth; empty unless it was asked for.
        regions: Likewise.
        snapshot: The driver's state at this moment, if asked for; None where the driver keeps none.
    """

    time_s: float
    target: TargetState
    entities: tuple[Entity, ...] = ()
    regions: tuple[Region, ...] = ()
    snapshot: Artefact | None = None


class RecordedFault(msgspec.Struct, frozen=True):
    """One fault as it happened, for the evidence; the agent does not read it."""

    kind: str
    time_s: float
    details: dict[str, Any]


class Ended(msgspec.Struct, frozen=True, tag=True):
    """Authority is back with the target.

    Attributes:
        faults: Those that became active during the session.
    """

    time_s: float
    faults: tuple[RecordedFault, ...]


class ToolResult(msgspec.Struct, frozen=True, tag=True):
    """What a tool gave.

    Attributes:
        artefacts: By name.
        reason: Why there are none, where the tool cannot give any here.
    """

    artefacts: dict[str, Artefact]
    reason: str = ""


class Frame(msgspec.Struct, frozen=True, kw_only=True):
    """One picture with depth, as the sensor tells it: noisy, late, and placed by a calibration that may be wrong.

    Pixel (u, v) with depth z lies at z * ((u - cx) / fx, (v - cy) / fy, 1) in the camera's frame.

    Attributes:
        time_s: The moment that the sensor claims to show, simulated time.
        width: Of this frame [pixels]; of the window, when a crop was asked for. cx and cy are of the window too.
        world_T_camera: OpenCV's convention: z forward, x right, y down.
        rgb: (height, width, 3) uint8.
        depth_m: (height, width) float32 along z; NaN where nothing was measured.
    """

    camera: str
    time_s: float
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    world_T_camera: Pose
    rgb: Colours
    depth_m: Depths


class Frames(msgspec.Struct, frozen=True, tag=True):
    """What the cameras gave.

    Attributes:
        frames: In the order asked for, those that came.
        missing: A code for each camera that gave none: `FRAME_DROPPED`, `CAMERA_SILENT`, `NO_GRAPHICS`.
    """

    frames: tuple[Frame, ...]
    missing: dict[str, str] = {}


MOTIONS = (Begin, Command, Halt, Settle, End)  # requests during which simulated time may move
Request = Describe | LoadScene | Begin | Command | Halt | Settle | End | Observe | Capture | InvokeTool | Shutdown
Reply = Ack | Refused | Description | Loaded | Step | Observation | Ended | ToolResult | Frames


REQUESTS = Codec[Request](Request, "request")
REPLIES = Codec[Reply](Reply, "reply")


class Here(ABC):
    """A channel to a target of this process, which can be asked without bytes in between."""

    @abstractmethod
    def ask(self, request: Request) -> Reply:
        """The reply to one request."""


def send(connection: Channel, message: Request | Reply) -> None:
    """Send one message."""
    connection.send_bytes(REQUESTS.encode(message))


def answer_bytes(handle: Callable[[Request], Reply], message: bytes) -> bytes:
    """One encoded request in, its encoded reply out."""
    return REPLIES.encode(handle(REQUESTS.decode(message)))


def receive_request(connection: Channel) -> Request:
    """Wait for the next request.

    Raises:
        EOFError: When the other side is gone.
        ExecutionError: `MALFORMED` when the bytes are no request; the connection can still be used.
    """
    return REQUESTS.decode(connection.recv_bytes())


def exchange(
    connection: Channel, request: Request, timeout_s: float, on_wait: Callable[[], None] | None = None
) -> Reply:
    """One request and its reply; the connection is closed when there is none, so that none is taken for another.

    Args:
        connection: To the target.
        request: What is asked.
        timeout_s: The longest wait for the reply [s].
        on_wait: Called several times a second meanwhile.

    Raises:
        ExecutionError: `TARGET_LOST`, as of `receive_reply`.
    """
    try:
        send(connection, request)
    except OSError as error:
        raise ExecutionError("TARGET_LOST", "the target closed the connection") from error
    waited_s = 0.0
    try:
        while on_wait is not None and waited_s < timeout_s and not connection.poll(WAIT_SLICE_S):
            on_wait()
            waited_s += WAIT_SLICE_S
        return receive_reply(connection, timeout_s - waited_s)
    except (ExecutionError, OSError) as error:
        connection.close()
        if isinstance(error, ExecutionError):
            raise
        raise ExecutionError("TARGET_LOST", "the target closed the connection") from error


def receive_reply(connection: Channel, timeout_s: float) -> Reply:
    """Wait for the reply.

    Raises:
        ExecutionError: `TARGET_LOST` when the world is gone, silent for `timeout_s` [s], or says what is no reply.
    """
    try:
        if not connection.poll(timeout_s):
            raise ExecutionError("TARGET_LOST", f"no reply within {timeout_s} s")
        message = connection.recv_bytes()
    except (EOFError, OSError) as error:
        raise ExecutionError("TARGET_LOST", "the world process closed the connection") from error
    try:
        return REPLIES.decode(message)
    except ExecutionError as error:
        raise ExecutionError("TARGET_LOST", str(error)) from error
