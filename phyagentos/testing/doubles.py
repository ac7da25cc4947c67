"""Doubles of what a session meets: a perfect target, the connection to it, and a planner that answers at once."""

from collections import deque
from collections.abc import Callable, Iterable

import numpy as np
from msgspec.structs import replace

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.workspace.array_files import encode_arrays
from phyagentos.protocol.world.environment import Entity, Pose, TargetState
from phyagentos.runtime.motion.requests import (
    Approach,
    Approaches,
    Array,
    Motion,
    MotionAnswer,
    MotionRequest,
    NoPlan,
    PlanMove,
    TimeLine,
    Timing,
    Trajectory,
)
from phyagentos.runtime.targets import wire

STEP_S = 0.002
N_STEPS = 10
TCP_M = (0.4, 0.0, 0.4)  # it stays there, however the joints move


class DirectConnection:
    """Both ends of the wire in one process: a request is carried out when it is sent, bytes and all."""

    def __init__(self, target: "PerfectTarget") -> None:
        self._target = target
        self._replies: deque[bytes] = deque()

    def send_bytes(self, message: bytes, /) -> None:
        """Have one request answered."""
        self._replies.append(wire.REPLIES.encode(self._target.handle(wire.REQUESTS.decode(message))))

    def recv_bytes(self) -> bytes:
        """The oldest reply; raises EOFError when nothing was requested."""
        if not self._replies:
            raise EOFError
        return self._replies.popleft()

    def poll(self, timeout_s: float = 0.0, /) -> bool:
        """Whether a reply waits."""
        return bool(self._replies)

    def close(self) -> None:
        """Nothing is open."""


class PerfectTarget:
    """A target that follows its set-points exactly and closes its fingers on the entity that `graspable` names.

    Attributes:
        requests: Every request so far, in order.
        stuck_joint: Index of a joint that does not move, if any.
    """

    def __init__(self, profile: TargetProfile, entities: Iterable[Entity] = (), graspable: str | None = None) -> None:
        self.profile = profile
        self.entities = {entity.name: entity for entity in entities}
        self.graspable = graspable
        self.time_s = 0.0
        self.q = np.array(profile.arm.home_rad)
        self.q_d = self.q.copy()
        self.qd = np.zeros_like(self.q)
        self.width_m = profile.gripper.max_width_m
        self.stuck_joint: int | None = None
        self.requests: list[wire.Request] = []

    def handle(self, request: wire.Request) -> wire.Reply:
        """The reply to one request."""
        self.requests.append(request)
        match request:
            case wire.Describe():
                return self._describe()
            case wire.LoadScene():
                return wire.Loaded(episode=request.episode, model_sha256="")
            case wire.Command():
                return self._carry_out(request)
            case wire.Halt():
                self.qd = np.zeros_like(self.q)
                return self._step()
            case wire.Settle():
                self.time_s += request.duration_s
                return self._step()
            case wire.Observe():
                return self._observe()
            case wire.End():
                return wire.Ended(time_s=self.time_s, faults=())
            case wire.InvokeTool(name=wire.RENDER):
                return wire.ToolResult({}, reason="no graphics")
            case wire.InvokeTool(name=wire.SCENE_MODEL):
                files = {"scene.mjb": b"model", "scene.xml": b"<mujoco/>"}
                return wire.ToolResult({name: wire.Artefact("text/plain", data) for name, data in files.items()})
        return wire.Ack()

    def commands(self) -> list[wire.Command]:
        """Every command so far, in order."""
        return [request for request in self.requests if isinstance(request, wire.Command)]

    def snapshot(self) -> wire.Artefact:
        """Its state as a target writes it."""
        arrays = {"state": self.q, "time": np.array(self.time_s), "qpos": self.q, "qvel": self.qd, "act": np.empty(0)}
        return wire.Artefact(wire.NPZ, encode_arrays(arrays))

    def _describe(self) -> wire.Description:
        arm = self.profile.arm
        return wire.Description(
            target=self.profile.target,
            n_joints=len(arm.joints),
            steps_per_command=N_STEPS,
            physics_step_s=STEP_S,
            q_min_rad=(-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973),
            q_max_rad=(2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973),
            observations=self.profile.observations,
            actions=self.profile.actions,
            cameras=(),
            mode="lockstep",
            kinematics=wire.Kinematics(
                axes=((0.0, 0.0, 1.0),) * len(arm.joints), anchors_m=(TCP_M,) * len(arm.joints), tcp_m=TCP_M
            ),
            gripper_force_n=self.profile.gripper.force_n,
            joints=arm.joints,
            version=wire.WIRE_VERSION,
            driver="mujoco",
            tools=(wire.Tool(wire.RENDER), wire.Tool(wire.SCENE_MODEL)),
            ground_truth=True,
        )

    def _carry_out(self, command: wire.Command) -> wire.Step:
        self.time_s += STEP_S * N_STEPS
        self.q_d = command.q_rad[-1]
        q = self.q_d.copy()
        if self.stuck_joint is not None:
            q[self.stuck_joint] = self.q[self.stuck_joint]
        self.q, self.qd = q, command.qd_rad_s[-1]
        self.width_m = float(command.gripper_width_m[-1])
        return self._step()

    def _state(self) -> TargetState:
        held = (self.graspable,) if self.graspable and self.width_m < 0.04 else ()
        return TargetState(
            q_rad=tuple(self.q.tolist()),
            qd_rad_s=tuple(self.qd.tolist()),
            gripper_width_m=self.width_m,
            tcp=Pose(TCP_M),
            holding=held,
        )

    def _step(self) -> wire.Step:
        error = float(np.abs(self.q - self.q_d).max())
        return wire.Step(time_s=self.time_s, target=self._state(), tracking_error_rad=error)

    def _observe(self) -> wire.Observation:
        return wire.Observation(
            time_s=self.time_s,
            target=self._state(),
            entities=tuple(replace(entity, observed_at_s=self.time_s) for entity in self.entities.values()),
            snapshot=self.snapshot(),
        )


class ScriptedPlanner:
    """Answers each request by a function, after `polls` polls; without one by straight lines in joint space.

    Attributes:
        requests: Every request so far, in order.
        cancelled, waits: How often a request was cancelled, and how often an answer was waited for.
    """

    def __init__(self, polls: int = 0, answer: Callable[[MotionRequest], MotionAnswer] | None = None) -> None:
        self.polls = polls
        self.requests: list[MotionRequest] = []
        self.cancelled = 0
        self.waits = 0
        self._answer = answer or compute_answer
        self._pending: MotionRequest | None = None
        self._left = 0

    @property
    def is_free(self) -> bool:
        """Whether no request is pending."""
        return self._pending is None

    def submit(self, request: MotionRequest) -> None:
        """Take one request at a time."""
        assert self._pending is None, "one request at a time"
        self.requests.append(request)
        self._pending, self._left = request, self.polls

    def poll(self) -> MotionAnswer | None:
        """The answer, once its polls are over."""
        if self._pending is None or self._left > 0:
            return None
        request, self._pending = self._pending, None
        return self._answer(request)

    def wait(self, timeout_s: float) -> bool:
        """Count one poll down."""
        self.waits += timeout_s > 0.0
        self._left -= self._left > 0
        return self._left == 0

    def cancel(self) -> None:
        """Forget the request."""
        self.cancelled += 1
        self._pending = None

    def close(self) -> None:
        """Nothing is open."""


def compute_answer(request: MotionRequest) -> MotionAnswer:
    """A straight line to the first goal, through the waypoints, or as the only approach."""
    timing = Timing(ms={"total": 1.0})
    match request:
        case PlanMove():
            return Motion(trajectory=compute_line(request.q_rad, request.goals_rad[0]), goal=0, timing=timing)
        case TimeLine():
            line = request.waypoints_rad
            return Motion(trajectory=compute_line(line[0], line[-1]), goal=0, timing=timing)
    home = np.asarray(getattr(request, "q_rad", 0.0))
    line = np.linspace(home + 0.2, home + 0.3, 5)
    return Approaches(approaches=(Approach(label="yaw+000", tcp_end=Pose(), line_rad=line),), timing=timing)


def refuse(request: MotionRequest) -> MotionAnswer:
    """No path, whatever the request."""
    return NoPlan(code="NO_PLAN", message="the wall is in the way", timing=Timing(ms={}), rejected={"ik": 3})


def compute_line(start: Array, end: Array, speed_rad_s: float = 0.5) -> Trajectory:
    """A straight motion (n, n_joints) with a quintic profile of time."""
    duration_s = max(0.1, 1.875 * float(np.abs(end - start).max()) / speed_rad_s)
    t = np.minimum(np.arange(1, int(np.ceil(duration_s / STEP_S)) + 1) * STEP_S / duration_s, 1.0)[:, None]
    s = 10 * t**3 - 15 * t**4 + 6 * t**5
    v = (30 * t**2 - 60 * t**3 + 30 * t**4) / duration_s
    return Trajectory(q_rad=start + s * (end - start), qd_rad_s=v * (end - start), step_s=STEP_S)
