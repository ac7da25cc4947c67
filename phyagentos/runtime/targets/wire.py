"""The messages between a worker and a target: msgpack, one request, one reply, in order. No simulator is presumed.

Arrays travel in C order with their shape: float64, pictures as uint8, depth as float32. What only a driver can read
(its state, a compiled model) travels as bytes with a media type. `handshake` opens a connection, `server` answers.
"""

import math
from collections.abc import Callable
from typing import Any, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import ExecutionError
from phyagentos.protocol.world.environment import Entity, Pose, Region, TargetState
from phyagentos.protocol.world.idealisations import Idealisation
from phyagentos.runtime.channel import Channel
from phyagentos.runtime.codec import Codec
from phyagentos.runtime.targets import handshake

Array = NDArray[np.float64]
Colours = NDArray[np.uint8]
Depths = NDArray[np.float32]
Crop = tuple[int, int, int, int]  # left, top, width, height [pixels]
WAIT_SLICE_S = 0.2  # interval of heartbeats during a long wait
SHARED_TIMEOUT_S = 600.0  # time may stand so long for other targets of a shared world: one plans, one is judged
WIRE_VERSION = handshake.WIRE_VERSION
NPZ = "application/x-npz"
RENDER = "render"  # tool: a picture for people; arguments `camera`, `width`, `height`; artefact `picture.png`
SCENE_MODEL = "scene_model"  # tool: the compiled scene, artefacts by file name
MOTION = "motion"  # tool: how the world has moved since the session began, artefact `motion.npz`


class Artefact(msgspec.Struct, frozen=True):
    """Bytes that a driver made, with their MIME type."""

    media_type: str
    data: bytes


class Describe(msgspec.Struct, frozen=True, tag=True):
    """Ask what the target is. Reply: `Description`."""


class LoadScene(msgspec.Struct, frozen=True, tag=True):
    """Begin an episode: build the scene, place the target at home, let things settle. Reply: `Loaded`.

    Only this request writes simulator state. It is refused when the episode is loaded with another scene or seed, and
    changes nothing when it is loaded with the same ones.

    Attributes:
        snapshot: The driver's own snapshot to start from (rerun of a recorded session); empty for a fresh start.
        may_reset: Whether this episode may replace another one.
    """

    scene: str
    seed: int
    episode: str
    snapshot: bytes = b""
    may_reset: bool = True


class Begin(msgspec.Struct, frozen=True, tag=True):
    """Give one session authority over the target. Reply: `Ack`. The epoch is a fencing token: it never decreases.

    Attributes:
        token: Of this epoch of the session, minted by the supervisor (see `handshake`); empty within one process.
    """

    session: str
    epoch: int
    token: bytes = b""


class Command(msgspec.Struct, frozen=True, tag=True):
    """One control period of set-points. Reply: `Step`.

    Attributes:
        q_rad: (n_steps, n_joints) joint position set-points, one row per physics step.
        qd_rad_s: (n_steps, n_joints) joint velocity set-points.
        gripper_width_m: (n_steps,) opening set-points.
        sequence: Number of the command in its session, from 1.
        expires_at_s: Simulated time after which the command must not be carried out.
    """

    session: str
    epoch: int
    sequence: int
    expires_at_s: float
    q_rad: Array
    qd_rad_s: Array
    gripper_width_m: Array


class Announce(msgspec.Struct, frozen=True, tag=True):
    """Announce a motion before its first command, to a target that shares its world. Reply: `Admission`.

    Attributes:
        q_rad: (n, n_joints) postures, one row per physics step.
        beside: A robot to which the motion comes near on purpose, as to take a thing out of its hand.
    """

    session: str
    epoch: int
    q_rad: Array
    beside: str = ""


class Halt(msgspec.Struct, frozen=True, tag=True):
    """Bring the target to rest within its limits, by its own means, and hold. Reply: `Step`.

    Attributes:
        category: Of the stop (IEC 60204-1, 9.2.2): after 2 the session may command again, after 1 only the next one.
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
        truth: Adds ground truth of entities and regions; refused where it is not offered (`NO_GROUND_TRUTH`).
        snapshot: Adds the driver's snapshot of the same moment.
    """

    truth: bool = False
    snapshot: bool = False


class InvokeTool(msgspec.Struct, frozen=True, tag=True):
    """Use a tool of the description. Reply: `ToolResult`. A tool that moves the target needs session and epoch."""

    name: str
    arguments: dict[str, Any] = {}
    session: str = ""
    epoch: int = 0


class Capture(msgspec.Struct, frozen=True, tag=True):
    """Ask RGB-D cameras for their latest frames without moving time. Reply: `Frames`.

    Attributes:
        cameras: Names of sensors.yaml; empty for all.
        crops: Regions to render instead of the whole picture, by camera.
        every: Subsampling factor of rows and columns, odd; the middle one of each group is read.
    """

    cameras: tuple[str, ...] = ()
    crops: dict[str, Crop] = {}
    every: int = 1


class Shutdown(msgspec.Struct, frozen=True, tag=True):
    """End the process. Reply: `Ack`."""


class Ack(msgspec.Struct, frozen=True, tag=True):
    """Done."""


class Refused(msgspec.Struct, frozen=True, tag=True):
    """Not done; nothing moved. Codes: `STALE_TOKEN`, `NO_AUTHORITY`, `OUT_OF_SEQUENCE`, `EXPIRED`, `MALFORMED`, ..."""

    code: str
    message: str


class Kinematics(msgspec.Struct, frozen=True):
    """A chain of hinges and slides as it stands at joint positions zero, in the world frame.

    Attributes:
        axes: (n_joints, 3) unit vectors of rotation or translation; zero for a slide without effect.
        anchors_m: (n_joints, 3) a point on each axis.
        tcp_m: (3,) the tool centre point.
        slides: (n_joints,) which joints slide; empty when all turn.
    """

    axes: tuple[tuple[float, float, float], ...]
    anchors_m: tuple[tuple[float, float, float], ...]
    tcp_m: tuple[float, float, float]
    slides: tuple[bool, ...] = ()


class Tool(msgspec.Struct, frozen=True):
    """An operation of a target besides set-points; one that `moves` the target needs authority."""

    name: str
    moves: bool = False


class Description(msgspec.Struct, frozen=True, tag=True):
    """What the target is, read from the live model rather than from its profile.

    No default of a missing field passes: preflight refuses the target, and the guard refuses every command.

    Attributes:
        kinematics: From joint positions to the tool centre point; None when unknown.
        gripper_force_n: Maximum force of a finger [N], 0 for one that cannot press; NaN when unknown.
        joints: In the order in which they are commanded; empty when unknown.
        depth_cameras: Cameras of sensors.yaml that this scene or robot has.
        version: Of the target's wire; 0 when unknown.
        driver: Its name in the registry; a relay prepends its own (`remote/mujoco`).
        shares_time: Whether other targets move in the same simulated time, so that a motion may wait for theirs.
        end_effector: `opening`, `suction` or `none`.
        idealisations: What of the target and its present world is simpler than reality.
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
    idealisations: tuple[Idealisation, ...] = ()

    def offers_tool(self, name: str) -> bool:
        """Whether there is a tool of this name."""
        return any(tool.name == name for tool in self.tools)


class Loaded(msgspec.Struct, frozen=True, tag=True):
    """The episode's world is loaded; the hash is that of the compiled model, empty without one."""

    episode: str
    model_sha256: str


class Admission(msgspec.Struct, frozen=True, tag=True):
    """Whether an announced motion may begin.

    Attributes:
        blocked_by: A robot that stands in its way, or has announced to pass there; empty when the motion is admitted.
    """

    blocked_by: str = ""


class Neighbour(msgspec.Struct, frozen=True):
    """Another robot of the same world.

    Attributes:
        target: Its measured state.
        announced_rad: (k, n_joints) postures of what is left of the motion that it has announced; none at rest.
    """

    name: str
    target: TargetState
    announced_rad: Array


class Step(msgspec.Struct, frozen=True, tag=True):
    """The world after one command: what a tick of a tree needs.

    Attributes:
        time_s: Simulated time.
        tracking_error_rad: Largest |q - q_d| at the end of the period.
        stopped: Code of the target's own protective stop. It is at rest then, and the session cannot command it again.
        contact_force_n: Maximum force on one other body since the latest report, by the joint torque sensors; None
            without such sensors.
        contact_force_error_n: Greatest expected difference from the true force.
        touched_n: Other robots that it touched since the latest report, with the maximum force between the two [N].
    """

    time_s: float
    target: TargetState
    tracking_error_rad: float
    stopped: str = ""
    contact_force_n: float | None = None
    contact_force_error_n: float = 0.0
    touched_n: dict[str, float] = {}


class Observation(msgspec.Struct, frozen=True, tag=True):
    """What the target senses of itself at one moment, before perception.

    Attributes:
        entities: Ground truth, on request; likewise `regions`, and `signals`, further measurements of the target by
            their names, flattened.
        snapshot: The driver's state at this moment, on request; None where the driver has none.
        neighbours: The other robots of its world, by name.
    """

    time_s: float
    target: TargetState
    entities: tuple[Entity, ...] = ()
    regions: tuple[Region, ...] = ()
    signals: dict[str, tuple[float, ...]] = {}
    snapshot: Artefact | None = None
    neighbours: tuple[Neighbour, ...] = ()


class RecordedFault(msgspec.Struct, frozen=True):
    """One fault as it happened, for the evidence; the agent does not read it."""

    kind: str
    time_s: float
    details: dict[str, Any]


class Beat(msgspec.Struct, frozen=True, tag=True):
    """The target still works on the oldest request; its reply follows. No reply to any request."""


class Ended(msgspec.Struct, frozen=True, tag=True):
    """Authority is back with the target; the faults became active during the session."""

    time_s: float
    faults: tuple[RecordedFault, ...]


class ToolResult(msgspec.Struct, frozen=True, tag=True):
    """Artefacts of a tool by name, or the reason why there are none."""

    artefacts: dict[str, Artefact]
    reason: str = ""


class Frame(msgspec.Struct, frozen=True, kw_only=True):
    """One picture with depth as the sensor reports it: noisy, delayed, with a calibration that may be wrong.

    Pixel (u, v) with depth z lies at z * ((u - cx) / fx, (v - cy) / fy, 1) in the camera's frame.

    Attributes:
        time_s: Simulated time of exposure, as the sensor states it.
        width: Of this frame or, with a crop, of its window [pixels]; cx and cy refer to the same.
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
    """Frames in the order of the request; `missing`: `FRAME_DROPPED`, `CAMERA_SILENT` or `NO_GRAPHICS` by camera."""

    frames: tuple[Frame, ...]
    missing: dict[str, str] = {}


MOTIONS = (Begin, Announce, Command, Halt, Settle, End)  # simulated time may move in these requests
Request = (
    Describe | LoadScene | Begin | Announce | Command | Halt | Settle | End | Observe | Capture | InvokeTool | Shutdown
)
Reply = Ack | Refused | Description | Loaded | Admission | Step | Observation | Ended | ToolResult | Frames | Beat
ReplyT = TypeVar("ReplyT", bound=Reply)

REQUESTS = Codec[Request](Request, "request")
REPLIES = Codec[Reply](Reply, "reply")


def exchange(connection: Channel, request: Request, timeout_s: float) -> Reply:
    """One request and its reply; see `await_reply`."""
    send_request(connection, request)
    return await_reply(connection, timeout_s)


def send_request(connection: Channel, request: Request) -> None:
    """Send one request; replies come in the order of requests.

    Raises:
        ExecutionError: `TARGET_LOST` when the target is gone.
    """
    try:
        connection.send_bytes(REQUESTS.encode(request))
    except OSError as error:
        raise ExecutionError("TARGET_LOST", "the target closed the connection") from error


def await_reply(
    connection: Channel, timeout_s: float, on_wait: Callable[[], bool] | None = None, *, is_last: bool = True
) -> Reply:
    """The next reply; without a sign for `timeout_s` [s] the connection is closed, so none is mistaken.

    Each `Beat` of the target is a sign. `on_wait` is called meanwhile, every `WAIT_SLICE_S` at least. When it says that
    the session is to end, one more request informs the target. It refuses a command that waits for other targets with
    `ABORTED`, and carries out a halt or settling as soon as none of them is in the middle of a motion. The answer to
    this request is read here, too, where the awaited reply `is_last` of all.

    Raises:
        ExecutionError: `TARGET_LOST`, as of `receive_reply`.
    """
    silent_s, is_ending = 0.0, False
    reply: Reply = Beat()
    try:
        while isinstance(reply, Beat):
            if on_wait is None or silent_s >= timeout_s or connection.poll(WAIT_SLICE_S):
                reply, silent_s = receive_reply(connection, timeout_s, silent_s), 0.0
            else:
                silent_s += WAIT_SLICE_S
            if isinstance(reply, Beat) and on_wait is not None and on_wait() and not is_ending:
                is_ending = True
                connection.send_bytes(REQUESTS.encode(Describe()))
        if is_ending and is_last:
            receive_reply(connection, timeout_s)
        return reply
    except (ExecutionError, OSError) as error:
        connection.close()
        if isinstance(error, ExecutionError):
            raise
        raise ExecutionError("TARGET_LOST", "the target closed the connection") from error


def require(request: Request, reply: Reply, expected: type[ReplyT]) -> ReplyT:
    """The reply of the expected type; raises ExecutionError: the code of a refusal, `PROTOCOL_BROKEN` otherwise."""
    if isinstance(reply, Refused):
        raise ExecutionError(reply.code, reply.message)
    if not isinstance(reply, expected):
        raise ExecutionError("PROTOCOL_BROKEN", f"{type(request).__name__} was answered by {type(reply).__name__}")
    return reply


def receive_reply(connection: Channel, timeout_s: float, silent_s: float = 0.0) -> Reply:
    """Wait for the reply of a target that has been silent for `silent_s` [s] by now.

    Raises:
        ExecutionError: `TARGET_LOST` when the target is gone, silent for `timeout_s` [s], or sends no valid reply.
    """
    try:
        if not connection.poll(max(timeout_s - silent_s, 0.0)):
            raise ExecutionError("TARGET_LOST", f"no reply within {timeout_s} s")
        message = connection.recv_bytes()
    except (EOFError, OSError) as error:
        raise ExecutionError("TARGET_LOST", "the world process closed the connection") from error
    try:
        return REPLIES.decode(message)
    except ExecutionError as error:
        raise ExecutionError("TARGET_LOST", str(error)) from error
