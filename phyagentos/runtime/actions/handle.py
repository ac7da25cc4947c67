"""The target session handle: the only connection from a worker to its target, over `targets.wire`.

It carries the session's authority (session, epoch, sequence number, expiry); the guard judges every command.
"""

from collections.abc import Callable, Collection
from typing import NoReturn

import msgspec
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import ExecutionError
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.session import Scene
from phyagentos.protocol.settings.runtime_contract import WorldMode
from phyagentos.protocol.settings.safety import TargetLimits
from phyagentos.protocol.world.environment import Environment
from phyagentos.runtime.actions.collision import PostureCollision
from phyagentos.runtime.actions.guard import Ruling, SafetyGuard
from phyagentos.runtime.actions.set_points import SetPoints
from phyagentos.runtime.actions.target_link import TargetLink
from phyagentos.runtime.actions.violations import Intervention, Violation
from phyagentos.runtime.channel import Channel
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.driver import VERBS
from phyagentos.runtime.targets.wire import ReplyT

OF_TARGETS = frozenset({"TARGET_LOST", "PROTOCOL_BROKEN"})  # codes by which a target itself is lost

EXPIRY_PERIODS = 3  # an older command was made for a state that has passed

OPERATIONS = {kind: verb.operation for kind, verb in VERBS.items() if verb.operation}  # of a session's manifest


class CommandRefused(ExecutionError):
    """A refused command.

    Attributes:
        by: `guard`, `target`, or `handle` for an operation outside the session's manifest.
        violation: The guard's finding, None when the target refused.
    """

    def __init__(
        self, code: str, message: str, by: str, violation: Violation | None = None, reaction: str = "refuse"
    ) -> None:
        self.by, self.violation, self.reaction = by, violation, reaction
        super().__init__(code, message)


class TargetSessionHandle:
    """Authority of one session over one target.

    Args:
        limits: Of this target, from safety.yaml.
        is_stopped: Whether the emergency stop is latched; called before every command.
        collision: The guard's stage for contacts of a posture.
        sees_truth: Whether observations come with the ground truth (`sensing: truth`).

    Attributes:
        link: To the target; its `is_ending` says whether the session is to end.
        is_pausing: Whether the session is to rest; for skills without an end of a motion to rest at.
        on_frames: Called as frames come: a look at several slow cameras takes many seconds.
        token: Of the epoch that begins next.
        latest: As `step`; None where no session has begun.
        is_at_rest: Whether the latest command left the arm at rest.

    Raises:
        ExecutionError: `TARGET_LOST` from every method when the world is gone or silent.
    """

    def __init__(
        self,
        connection: Channel,
        limits: TargetLimits,
        *,
        is_stopped: Callable[[], bool] | None = None,
        collision: PostureCollision | None = None,
        sees_truth: bool = False,
    ) -> None:
        self.is_pausing: Callable[[], bool] = lambda: False
        self.on_frames: Callable[[], None] = lambda: None
        self.token = b""
        self._is_stopped, self._collision, self._sees_truth = is_stopped, collision, sees_truth
        self._interventions: list[Intervention] = []
        self.link = TargetLink(connection)
        self._limits = limits
        self._description: wire.Description | None = None
        self._loaded: tuple[Scene, wire.Loaded] | None = None  # this connection's world; no other one loads scenes
        self._guard: SafetyGuard | None = None  # of the session that has authority
        self._made: tuple[wire.Description, SafetyGuard] | None = None  # for the target as it described itself
        self._session = ""
        self._epoch = 0
        self._sequence = 0
        self._n_calls = 0
        self.latest: wire.Step | None = None
        self.is_at_rest = True
        self._permitted: frozenset[str] = frozenset((*OPERATIONS.values(), wire.RENDER))

    def permit(self, operations: Collection[str]) -> None:
        """Permit the session these operations, and halt: its TargetToolManifest."""
        self._permitted = frozenset((*operations, "halt"))

    def permits(self, operation: str) -> bool:
        """Whether the session may use an operation."""
        return operation in self._permitted

    def describe(self) -> wire.Description:
        """The target's description; requested once a scene."""
        if self._description is None:
            self._description = self._ask(wire.Describe())
            self.link.shares_time = self._description.shares_time
        return self._description

    def load(self, scene: Scene, snapshot: bytes = b"", *, may_reset: bool = True) -> wire.Loaded:
        """Make the scene's episode the present world; no request is sent when it already is.

        A rerun starts from the driver's own `snapshot`. The target refuses to end another episode with
        `NOT_PERMITTED` unless it `may_reset`.
        """
        if not snapshot and self._loaded is not None and self._loaded[0] == scene:
            if not self._shares_time:
                return self._loaded[1]
        else:
            self._description = None  # cameras belong to the scene
        self._loaded = None
        request = wire.LoadScene(
            scene=scene.name, seed=scene.seed, episode=scene.episode, snapshot=snapshot, may_reset=may_reset
        )
        loaded = self._ask(request)
        self._loaded = None if snapshot else (scene, loaded)
        return loaded

    def begin(self, session: str, epoch: int) -> wire.Observation:
        """Take authority for one session, and observe once, with a snapshot."""
        description = self.describe()
        self._ask(wire.Begin(session=session, epoch=epoch, token=self.token))
        self._session, self._epoch, self._sequence, self.is_at_rest = session, epoch, 0, True
        self.link.clear()
        observation = self.observe(snapshot=True)
        if self._made is None or self._made[0] is not description:
            guard = SafetyGuard(
                self._limits,
                description,
                is_stopped=self._is_stopped,
                find_contact=self._collision.find_contact if self._collision is not None else None,
            )
            self._made = (description, guard)
        self._guard = self._made[1]
        self._guard.begin(np.asarray(observation.target.q_rad, dtype=np.float64))
        self.latest = wire.Step(observation.time_s, observation.target, tracking_error_rad=0.0)
        return observation

    def guard_against(self, world: Environment) -> None:
        """Check commanded postures against the fixed entities of this world from now on."""
        if self._collision is not None:
            target = self.step.target
            q_rad = np.asarray(target.q_rad, dtype=np.float64)
            self._collision.update(world.entities.values(), q_rad, target.gripper_width_m)

    @property
    def step(self) -> wire.Step:
        """The world after the latest command of this session."""
        if self.latest is None:
            raise ExecutionError("NO_AUTHORITY", "no session has begun on this target; call begin() first")
        return self.latest

    @property
    def start_rad(self) -> NDArray[np.float64]:
        """Where the arm rests before the first command of this session (n_joints,), by one reading of its encoders.

        The guard judges from here, so motions are planned from here: the noise of two readings looks like acceleration.
        """
        if self._guard is None:
            raise ExecutionError("NO_AUTHORITY", "no session has begun on this target; call begin() first")
        return self._guard.start_rad

    @property
    def can_run_ahead(self) -> bool:
        """Whether a command may be sent before the report of the previous one: in lockstep of its own time."""
        return self.describe().mode == WorldMode.LOCKSTEP and not self._shares_time

    def apply(self, points: SetPoints) -> wire.Step:
        """Guard one control period and carry it out.

        Raises:
            CommandRefused: By the guard or the target. Nothing moved, or the target stopped by its own means.
        """
        self.link.send(self.judge(points))
        return self.collect()

    def judge(self, points: SetPoints) -> wire.Command:
        """Guard one control period; the command is to be sent before another one is judged, and `collect` reports it.

        The target carries out commands in the order of their numbers, and none behind a refused one.

        Raises:
            CommandRefused: By the guard.
        """
        if self._guard is None:
            raise ExecutionError("NO_AUTHORITY", "no session has begun on this target; call begin() first")
        self._check_permitted(OPERATIONS[wire.Command])
        description = self.describe()
        if self.is_at_rest and (description.mode == WorldMode.REALTIME or description.shares_time):
            self.settle(0.0)  # time may have gone on
        period_s = description.physics_step_s * description.steps_per_command
        now = self.step
        if ahead := self.link.n_commands:
            now = msgspec.structs.replace(now, time_s=now.time_s + ahead * period_s)
        command = wire.Command(
            session=self._session,
            epoch=self._epoch,
            sequence=self._sequence + 1,
            expires_at_s=now.time_s + EXPIRY_PERIODS * period_s,
            q_rad=points.q_rad,
            qd_rad_s=points.qd_rad_s,
            gripper_width_m=points.gripper_width_m,
        )
        ruling = self._guard.judge(command, now)
        self._interventions += ruling.interventions
        if ruling.command is None:
            self._refuse(ruling)
        self._sequence += 1
        self.is_at_rest = not ruling.command.qd_rad_s[-1].any()
        return ruling.command

    def collect(self) -> wire.Step:
        """The report of the oldest command that was sent.

        Raises:
            CommandRefused: By the target, which refuses those behind it as well, or stopped by its own means.
        """
        try:
            self.latest = self._expect(wire.Command, self.link.collect())
            if self.latest.stopped:
                raise CommandRefused(
                    self.latest.stopped,
                    message=f"the target stopped by itself in the middle of a command: {self.latest.stopped}",
                    by="target",
                    reaction="stop_category_2",
                )
        except CommandRefused:
            while self.link.n_sent:
                self.link.collect()
            raise
        return self.latest

    def request_frames(self, capture: wire.Capture) -> None:
        """Request the frames at the end of the command that was sent last; `collect_frames` returns them."""
        self._check_permitted(OPERATIONS[wire.Capture])
        self.link.send(capture)

    def collect_frames(self) -> wire.Frames:
        """The frames that were requested behind the command whose report was collected last."""
        return self._expect(wire.Capture, self.link.collect())

    def take_interventions(self) -> list[Intervention]:
        """Changes of the guard since the last call; for the evidence."""
        taken, self._interventions = self._interventions, []
        return taken

    def _refuse(self, ruling: Ruling) -> NoReturn:
        violation = ruling.violation
        if violation is None:
            raise ExecutionError("PROTOCOL_BROKEN", "a command was refused for no reason")
        if ruling.reaction.startswith("stop"):
            self.halt(int(ruling.reaction[-1]))
        raise CommandRefused(
            violation.code,
            message=f"the guard refused a command: {violation}",
            by="guard",
            violation=violation,
            reaction=ruling.reaction,
        )

    def observe(self, *, snapshot: bool = False) -> wire.Observation:
        """The present sensing, with the target's snapshot of the same moment on request; time does not move."""
        return self._ask(wire.Observe(truth=self._sees_truth, snapshot=snapshot))

    def read_neighbours(self) -> tuple[wire.Neighbour, ...]:
        """The other robots of a shared world as they stand and move now; none where time is not shared."""
        return self.observe().neighbours if self._shares_time else ()

    def announce(self, q_rad: NDArray[np.float64], beside: str = "") -> str:
        """Announce a motion (n, n_joints), one posture a physics step; the robot that is in its way, empty if none.

        What else refuses it refuses its first command, too. `beside` is a robot to which it comes near on purpose.
        """
        if not self._shares_time:
            return ""
        request = wire.Announce(session=self._session, epoch=self._epoch, q_rad=q_rad, beside=beside)
        try:
            return self._ask(request).blocked_by
        except CommandRefused:
            return ""

    def halt(self, category: int = 2) -> wire.Step:
        """Let the target bring itself to rest, by a stop of this category."""
        self.latest = self._ask(wire.Halt(session=self._session, epoch=self._epoch, category=category))
        return self.latest

    def settle(self, duration_s: float) -> wire.Step:
        """Hold still for `duration_s` [s] of the target's time."""
        self.latest = self._ask(wire.Settle(session=self._session, epoch=self._epoch, duration_s=duration_s))
        if self._guard is not None and not self._sequence:  # the first command begins where the arm stands now
            self._guard.begin_again(np.asarray(self.latest.target.q_rad, dtype=np.float64))
        return self.latest

    def call(self, procedure: str, goal: Fields, cancel_within_s: float) -> tuple[int, wire.Progress]:
        """Start a procedure of the target, as of `wire.Call`; its number, and how far it is."""
        self._n_calls += 1
        request = wire.Call(self._session, self._epoch, self._n_calls, procedure, goal, cancel_within_s)
        return self._n_calls, self._ask(request)

    def follow(self, number: int) -> wire.Progress:
        """How far a call is."""
        return self._ask(wire.Follow(self._session, self._epoch, number))

    def cancel(self, number: int) -> wire.Progress:
        """Ask for the end of a call."""
        return self._ask(wire.Cancel(self._session, self._epoch, number))

    def end(self) -> wire.Ended:
        """Give authority back."""
        ended = self._ask(wire.End(session=self._session, epoch=self._epoch))
        self._guard, self.latest = None, None
        return ended

    def render(self, camera: str, width: int = 640, height: int = 480) -> bytes:
        """A PNG of the present; empty where the target cannot render."""
        self._check_permitted(wire.RENDER)
        result = self._invoke(wire.RENDER, camera=camera, width=width, height=height)
        return result.artefacts["picture.png"].data if result.artefacts else b""

    def render_ahead(self, camera: str, name: str) -> bool:
        """Let the target begin a picture of the present, to be fetched by `PICTURES`; whether it can."""
        if can := self.describe().offers_tool(wire.RENDER_AHEAD):
            self._invoke(wire.RENDER_AHEAD, camera=camera, name=name)
        return can

    def fetch_files(self, tool: str, **arguments: bool) -> dict[str, bytes]:
        """What a tool keeps for the evidence, by file name; empty where the target has no such tool."""
        if not self.describe().offers_tool(tool):
            return {}
        return {name: file.data for name, file in self._invoke(tool, **arguments).artefacts.items()}

    def _invoke(self, tool: str, **arguments: str | int) -> wire.ToolResult:
        return self._ask(wire.InvokeTool(name=tool, arguments=arguments, session=self._session, epoch=self._epoch))

    def capture(
        self, cameras: tuple[str, ...] = (), crops: dict[str, wire.Crop] | None = None, every: int = 1
    ) -> wire.Frames:
        """The latest frames of these RGB-D cameras, all of them when none is named; time does not move."""
        frames = self._ask(wire.Capture(cameras=cameras, crops=crops or {}, every=every))
        self.on_frames()
        return frames

    def _ask(self, request: wire.RequestFor[ReplyT]) -> ReplyT:
        self._check_permitted(VERBS[type(request)].operation)
        return self._expect(type(request), self.link.ask(request))

    def _expect(self, kind: type[wire.RequestFor[ReplyT]], reply: wire.Reply) -> ReplyT:
        if isinstance(reply, wire.Refused):
            message = f"the target refused {kind.__name__}: {reply.message}"
            message = reply.message if reply.code in OF_TARGETS else message  # no refusal, but no sound answer
            raise CommandRefused(reply.code, message, "target")
        return wire.require(kind, reply)

    def _check_permitted(self, operation: str) -> None:
        if operation and operation not in self._permitted:
            raise CommandRefused(
                "NOT_PERMITTED", message=f"{operation!r} is not in the manifest of the session", by="handle"
            )

    @property
    def _shares_time(self) -> bool:
        """Whether other targets move in the same time; another worker may begin an episode there, too."""
        return self.link.shares_time and self._description is not None
