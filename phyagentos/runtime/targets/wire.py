"""The messages between a worker and a target: msgpack, one request, one reply, in order. No simulator is presumed.

Arrays travel in C order with their shape: float64, pictures as uint8, depth as float32. What only a driver can read
(its state, a compiled model) travels as bytes with a media type. `handshake` opens a connection, `server` answers.
"""

import math
from collections.abc import Callable
from enum import StrEnum
from typing import Any, Generic, TypeVar, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray
from typing_extensions import get_original_bases

from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError
from phyagentos.protocol.documents.plain_data import Fields
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
RENDER = "render"  # tool: a picture for people; arguments `camera`, `width`, `height`; artefact `PICTURE`
RENDER_AHEAD = "render_ahead"  # tool: begins what `render` makes, beside all else; arguments as there, and `name`
PICTURES = "pictures"  # tool: those that were begun and are done, or with `wait` all, by their names; each once
PICTURE = "picture.png"
SCENE_MODEL = "scene_model"  # tool: the compiled scene, artefacts by file name
MOTION = "motion"  # tool: how the world has moved since the session began, artefact `motion.npz`


class Artefact(msgspec.Struct, frozen=True):
    """Bytes that a driver made, with their MIME type."""

    media_type: str
    data: bytes


class Ack(msgspec.Struct, frozen=True, tag=True):
    """Done."""


class Refused(msgspec.Struct, frozen=True, tag=True):
    """Not done; nothing moved. Codes: `STALE_TOKEN`, `NO_AUTHORITY`, `EXPIRED`, `MALFORMED`, ..."""

    code: str
    message: str


class Kinematics(msgspec.Struct, frozen=True):
    """A chain of hinges and slides as it stands at joint positions zero, in the world frame.

    `axes` (n_joints, 3) are unit vectors of rotation or translation, zero for a slide without effect, with a point on
    each, and `slides` says which joints slide, empty when all turn; `tcp_m` (3,) is the tool centre point.
    """

    axes: tuple[tuple[float, float, float], ...]
    anchors_m: tuple[tuple[float, float, float], ...]
    tcp_m: tuple[float, float, float]
    slides: tuple[bool, ...] = ()


class Tool(msgspec.Struct, frozen=True):
    """An operation of a target besides set-points; one that `moves` the target needs authority."""

    name: str
    moves: bool = False


class Procedure(msgspec.Struct, frozen=True):
    """What a target does by itself when it is called; its set-points hold the joints still meanwhile.

    Attributes:
        name: As trees write it.
        kind: `action`, `service`, `topic`; `procedure` where it is none of ROS.
        type: Of its messages, such as `nav2_msgs/action/NavigateToPose`; empty where they have none.
        goal: Type by path (`pose.position.x`, `poses[].header.stamp.sec`): `number`, `integer`, `string`, `boolean`,
            `pose`, `point`, or one of the first four with `[]`. `feedback` and `result` alike.
    """

    name: str
    kind: str = "procedure"
    type: str = ""
    goal: dict[str, str] = {}
    feedback: dict[str, str] = {}
    result: dict[str, str] = {}


class CallState(StrEnum):
    """How far a call is."""

    PENDING = "pending"
    """Not accepted yet."""
    RUNNING = "running"
    """Accepted."""
    CANCELLING = "cancelling"
    """A cancel was requested and not confirmed."""
    SUCCEEDED = "succeeded"
    """Its server says so; whether it is true decides the verifier."""
    ABORTED = "aborted"
    """Its server gave up."""
    REJECTED = "rejected"
    """Its server did not accept the goal."""
    CANCELLED = "cancelled"
    """Ended by a cancel or a stop."""
    LOST = "lost"
    """Its server is gone, or did not confirm a cancel in time."""

    @property
    def has_ended(self) -> bool:
        """Whether no other state follows."""
        return self not in (CallState.PENDING, CallState.RUNNING, CallState.CANCELLING)


class Progress(msgspec.Struct, frozen=True, tag=True):
    """A call of a procedure: its latest feedback and, at its end, its result, by path."""

    state: CallState
    feedback: Fields = {}
    result: Fields = {}
    message: str = ""


class Description(msgspec.Struct, frozen=True, tag=True):
    """What the target is, read from the live model rather than from its profile.

    No default of a missing field passes: preflight refuses the target, and the guard refuses every command.

    Attributes:
        kinematics: From joint positions to the tool centre point; None when unknown.
        gripper_force_n: Maximum force of a finger [N], 0 for one that cannot press; NaN when unknown.
        joints: In the order in which they are commanded; empty when unknown.
        depth_cameras: Cameras of sensors.yaml that this scene or robot has.
        counts_frames: Whether their frames carry the sensor's own count of exposures.
        version: Of the target's wire; 0 when unknown.
        driver: Its name in the registry; a relay prepends its own (`remote/mujoco`).
        shares_time: Whether other targets move in the same simulated time, so that a motion may wait for theirs.
        end_effector: `opening`, `suction` or `none`.
        idealisations: What of the target and its present world is simpler than reality.
        procedures: What it does when it is called.
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
    counts_frames: bool = False
    procedures: tuple[Procedure, ...] = ()

    def offers_tool(self, name: str) -> bool:
        """Whether there is a tool of this name."""
        return any(tool.name == name for tool in self.tools)


class Loaded(msgspec.Struct, frozen=True, tag=True):
    """The episode's world is loaded; the hash is that of the compiled model, empty without one."""

    episode: str
    model_sha256: str


class Admission(msgspec.Struct, frozen=True, tag=True):
    """Whether an announced motion may begin, or which robot stands in its way, or has announced to pass there."""

    blocked_by: str = ""


class Neighbour(msgspec.Struct, frozen=True):
    """Another robot of the same world, and what is left of the motion (k, n_joints) that it has announced."""

    name: str
    target: TargetState
    announced_rad: Array


class Step(msgspec.Struct, frozen=True, tag=True):
    """The world after one command: what a tick of a tree needs.

    Attributes:
        tracking_error_rad: Largest |q - q_d| at the end of the period.
        stopped: Code of the target's own protective stop. It is at rest then, and the session cannot command it again.
        contact_force_n: Maximum force on one other body since the latest report, by the joint torque sensors; None
            without such sensors. `contact_force_error_n` is the greatest expected difference from the true force.
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

    On request it has ground truth, `entities` and `regions`, and the driver's snapshot, None where it has none.
    `signals` are further measurements of the target by their names, flattened; `neighbours` other robots of its world,
    by name.
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
    details: Fields


class KeepAlive(msgspec.Struct, frozen=True, tag="Beat"):
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
        number: The sensor's own count of its exposures; negative where it has none.
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
    number: int = -1


class Frames(msgspec.Struct, frozen=True, tag=True):
    """Frames in the order of the request; `missing`: `OBSERVATION_UNAVAILABLE` or `NO_GRAPHICS` by camera."""

    frames: tuple[Frame, ...]
    missing: dict[str, str] = {}


Reply = (
    Ack
    | Refused
    | Description
    | Loaded
    | Admission
    | Step
    | Observation
    | Ended
    | ToolResult
    | Frames
    | Progress
    | KeepAlive
)
ReplyT = TypeVar("ReplyT", bound=Reply)


class RequestFor(msgspec.Struct, Generic[ReplyT], frozen=True):
    """What a client sends; its parameter is the reply, unless the target refuses."""


class OfSession(RequestFor[ReplyT], frozen=True):
    """A request in the name of one epoch of a session."""

    session: str
    epoch: int


class Describe(RequestFor[Description], frozen=True, tag=True):
    """Ask what the target is."""


class LoadScene(RequestFor[Loaded], frozen=True, tag=True):
    """Begin an episode: build the scene, place the target at home, let objects settle.

    Only this request writes simulator state. It is refused when the episode is loaded with another scene or seed, or
    would replace another one without `may_reset`, and changes nothing when it is loaded with the same ones. A rerun
    of a recorded session starts at the driver's own snapshot.
    """

    scene: str
    seed: int
    episode: str
    snapshot: bytes = b""
    may_reset: bool = True


class Begin(OfSession[Ack], frozen=True, tag=True):
    """Give one session authority over the target. The epoch is a fencing token: it never decreases.

    `token` is of this epoch of the session, minted by the supervisor (see `handshake`); empty within one process.
    """

    token: bytes = b""


class Command(OfSession[Step], frozen=True, tag=True):
    """One control period of set-points, one row per physics step; commands of a session count from 1.

    The arrays are (n_steps, n_joints), (n_steps, n_joints) and (n_steps,); after `expires_at_s`, in simulated time, the
    command must not be carried out.
    """

    sequence: int
    expires_at_s: float
    q_rad: Array
    qd_rad_s: Array
    gripper_width_m: Array


class Announce(OfSession[Admission], frozen=True, tag=True):
    """Announce a motion (n, n_joints), one row per physics step, before its first command, in a shared world.

    It may come near to the robot `beside` on purpose, as to take an object out of its hand.
    """

    q_rad: Array
    beside: str = ""


class Halt(OfSession[Step], frozen=True, tag=True):
    """Bring the target to rest within its limits, by its own means, and hold.

    After a stop of category 2 (IEC 60204-1, 9.2.2) the session may command again, after 1 only the next one. An
    emergency stop is the device's own, where it has one; no session begins before it is reset.
    """

    category: int = 2
    is_emergency: bool = False


class Settle(OfSession[Step], frozen=True, tag=True):
    """Hold still for some simulated time."""

    duration_s: float


class End(OfSession[Ended], frozen=True, tag=True):
    """Take authority back: no later command of this session is accepted."""


class Observe(RequestFor[Observation], frozen=True, tag=True):
    """Ask for an observation without moving time, and for the driver's snapshot of the moment.

    `truth` adds ground truth of entities and regions; refused where it is not offered (`REQUEST_INVALID`).
    """

    truth: bool = False
    snapshot: bool = False


class InvokeTool(RequestFor[ToolResult], frozen=True, tag=True):
    """Use a tool of the description. A tool that moves the target needs session and epoch."""

    name: str
    arguments: Fields = {}
    session: str = ""
    epoch: int = 0


class Call(OfSession[Progress], frozen=True, tag=True):
    """Start a procedure of the description; calls of a session have numbers.

    It is cancelled by every halt and stop, at the end of the session, and where no request comes in time. Once a cancel
    was not confirmed for `cancel_within_s` [s], the target takes no command any more (`PROTECTIVE_STOP`).
    """

    number: int
    procedure: str
    goal: Fields
    cancel_within_s: float


class Follow(OfSession[Progress], frozen=True, tag=True):
    """Ask how far a call is."""

    number: int


class Cancel(OfSession[Progress], frozen=True, tag=True):
    """Ask for the end of a call, also before it is accepted."""

    number: int


class Capture(RequestFor[Frames], frozen=True, tag=True):
    """Ask RGB-D cameras, all if none is named, for their latest frames without moving time.

    `crops` are regions to render instead of the whole picture, by camera; of `every` so many rows and columns, odd, the
    middle one is read.
    """

    cameras: tuple[str, ...] = ()
    crops: dict[str, Crop] = {}
    every: int = 1


class Shutdown(RequestFor[Ack], frozen=True, tag=True):
    """End the process."""


Request = RequestFor[Any]
_REQUESTS = (
    Describe
    | LoadScene
    | Begin
    | Announce
    | Command
    | Call
    | Follow
    | Cancel
    | Halt
    | Settle
    | End
    | Observe
    | Capture
    | InvokeTool
    | Shutdown
)
_EXPECTED: dict[type, Any] = {each: get_args(get_original_bases(each)[0])[0] for each in get_args(_REQUESTS)}

REQUESTS = Codec[Request](_REQUESTS, "request")
REPLIES = Codec[Reply](Reply, "reply")


def exchange(connection: Channel, request: Request, timeout_s: float) -> Reply:
    """One request and its reply; see `await_reply`."""
    send_request(connection, request)
    return await_reply(connection, timeout_s)


def send_request(connection: Channel, request: Request) -> None:
    """Send one request; replies come in the order of requests. Raises ExecutionError `TARGET_LOST`."""
    try:
        connection.send_bytes(REQUESTS.encode(request))
    except OSError as error:
        raise ExecutionError("TARGET_LOST", "the target closed the connection") from error


def await_reply(
    connection: Channel,
    timeout_s: float,
    on_wait: Callable[[], bool] | None = None,
    *,
    is_last: bool = True,
    beats_max_s: float = SHARED_TIMEOUT_S,
    ending_max_s: float = SHARED_TIMEOUT_S,
) -> Reply:
    """The next reply; without a sign for `timeout_s` [s] the connection is closed, so none is mistaken.

    Each `KeepAlive` of the target is a sign; they stand for a reply for `beats_max_s` [s] at most, for `ending_max_s`
    once the session is to end. `on_wait` is called meanwhile, every `WAIT_SLICE_S` at least. When it says that the
    session is to end, one more request informs the target. It refuses a command that waits for other targets with
    `ABORTED`, and carries out a halt or settling as soon as none of them is in the middle of a motion. The answer to
    this request is read here, too, where the awaited reply `is_last` of all.

    Raises:
        ExecutionError: `TARGET_LOST`, as of `receive_reply`.
    """
    silent_s, is_ending, clock = 0.0, False, SystemClock()
    until_s, limit = clock.now_s() + beats_max_s, f"within {beats_max_s:g} s"
    reply: Reply = KeepAlive()
    try:
        while isinstance(reply, KeepAlive):
            if clock.now_s() > until_s:
                raise ExecutionError("TARGET_LOST", f"signs of life, but no reply {limit}")
            if on_wait is None or silent_s >= timeout_s or connection.poll(WAIT_SLICE_S):
                reply, silent_s = receive_reply(connection, timeout_s, silent_s), 0.0
            else:
                silent_s += WAIT_SLICE_S
            if isinstance(reply, KeepAlive) and on_wait is not None and on_wait() and not is_ending:
                is_ending = True
                if (ended_s := clock.now_s() + ending_max_s) < until_s:
                    until_s, limit = ended_s, f"within {ending_max_s:g} s of the request to end"
                connection.send_bytes(REQUESTS.encode(Describe()))
        if is_ending and is_last:
            receive_reply(connection, timeout_s)
        return reply
    except (ExecutionError, OSError) as error:
        connection.close()
        if isinstance(error, ExecutionError):
            raise
        raise ExecutionError("TARGET_LOST", "the target closed the connection") from error


def require(kind: type[RequestFor[ReplyT]], reply: Reply) -> ReplyT:
    """The reply to a request; raises ExecutionError: the code of a refusal, `PROTOCOL_BROKEN` for another reply."""
    if isinstance(reply, find_expected(kind)):
        return reply
    if isinstance(reply, Refused):
        raise ExecutionError(reply.code, reply.message)
    raise ExecutionError("PROTOCOL_BROKEN", f"{kind.__name__} was answered by {type(reply).__name__}")


def find_expected(kind: type[RequestFor[ReplyT]]) -> type[ReplyT]:
    """The kind of reply that requests of a kind expect: the parameter of their base class."""
    return _EXPECTED[kind]  # type: ignore[no-any-return]


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
