"""The target session handle: the only door from a worker to its target.

Upstream: `runner` and whatever perceives. Downstream: the world process, over `targets.wire`. It carries the session's
authority (session, epoch, sequence number, expiry) and lets no command out that the guard has not seen.
"""

from pathlib import Path
from typing import TypeVar

import numpy as np

from phyagentos.errors import ExecutionError
from phyagentos.protocol.channel import Channel
from phyagentos.protocol.sessions import Scene
from phyagentos.protocol.settings import TargetLimits
from phyagentos.runtime.actions.guard import SafetyGuard, Violation
from phyagentos.runtime.actions.set_points import SetPoints
from phyagentos.runtime.targets import wire

EXPIRY_PERIODS = 3  # a command that waits longer than this belongs to a past that nobody sees any more
REPLY_TIMEOUT_S = 10.0  # a control period takes milliseconds; a world that is silent for this long is lost
LOAD_TIMEOUT_S = 120.0  # a scene with meshes compiles in seconds

ReplyT = TypeVar("ReplyT", bound=wire.Reply)


class CommandRefused(ExecutionError):
    """A command that did not get through.

    Attributes:
        by: `guard` or `target`.
        violation: What the guard found, None when the target refused.
    """

    def __init__(self, code: str, message: str, by: str, violation: Violation | None = None) -> None:
        self.by = by
        self.violation = violation
        super().__init__(code, message)


class TargetSessionHandle:
    """Authority of one session over one target.

    Args:
        connection: To the world process.
        limits: Of this target, from safety.yaml.

    Raises:
        ExecutionError: `TARGET_LOST` from every method when the world is gone or silent.
    """

    def __init__(self, connection: Channel, limits: TargetLimits) -> None:
        self._connection = connection
        self._limits = limits
        self._description: wire.Description | None = None
        self._guard: SafetyGuard | None = None
        self._session = ""
        self._epoch = 0
        self._sequence = 0
        self._step: wire.Step | None = None

    def describe(self) -> wire.Description:
        """What the target is; asked once a scene."""
        if self._description is None:
            self._description = self._ask(wire.Describe(), wire.Description)
        return self._description

    def load(self, scene: Scene, state: wire.Array | None = None) -> wire.Loaded:
        """Make the scene's episode the present world; a no-op when it is.

        Args:
            scene: Name, seed and episode.
            state: mjSTATE_INTEGRATION to start from instead of a fresh world (rerun of a recorded session).
        """
        self._description = None  # cameras belong to the scene
        request = wire.LoadScene(scene=scene.name, seed=scene.seed, episode=scene.episode, state=state)
        return self._ask(request, wire.Loaded, LOAD_TIMEOUT_S)

    def begin(self, session: str, epoch: int) -> wire.Observation:
        """Take authority for one session and look once."""
        self._ask(wire.Begin(session=session, epoch=epoch), wire.Ack)
        self._session, self._epoch, self._sequence = session, epoch, 0
        observation = self.observe()
        self._guard = SafetyGuard(self._limits, self.describe())
        self._guard.begin(np.asarray(observation.target.q_rad, dtype=np.float64))
        self._step = wire.Step(
            time_s=observation.time_s,
            target=observation.target,
            tracking_error_rad=0.0,
            touching=observation.target.holding,
        )
        return observation

    @property
    def step(self) -> wire.Step:
        """The world after the latest command of this session."""
        if self._step is None:
            raise ExecutionError("NO_AUTHORITY", "no session has begun on this target; call begin() first")
        return self._step

    def apply(self, points: SetPoints) -> wire.Step:
        """Guard one control period and carry it out.

        Raises:
            CommandRefused: When the guard or the target refuses it; nothing moved.
        """
        if self._guard is None:
            raise ExecutionError("NO_AUTHORITY", "no session has begun on this target; call begin() first")
        description = self.describe()
        period_s = description.physics_step_s * description.steps_per_command
        command = wire.Command(
            session=self._session,
            epoch=self._epoch,
            sequence=self._sequence + 1,
            expires_at_s=self.step.time_s + EXPIRY_PERIODS * period_s,
            q_rad=points.q_rad,
            qd_rad_s=points.qd_rad_s,
            gripper_width_m=points.gripper_width_m,
        )
        violation = self._guard.check(command, self.step)
        if violation is not None:
            raise CommandRefused(violation.code, f"the guard refused a command: {violation}", "guard", violation)
        self._sequence += 1
        self._step = self._ask(command, wire.Step)
        return self._step

    def observe(self) -> wire.Observation:
        """Everything that is sensed now; time does not move."""
        return self._ask(wire.Observe(), wire.Observation)

    def halt(self) -> wire.Step:
        """Let the target bring itself to rest."""
        self._step = self._ask(wire.Halt(session=self._session, epoch=self._epoch), wire.Step)
        return self._step

    def settle(self, duration_s: float) -> wire.Step:
        """Hold still for `duration_s` [s] of the target's time."""
        request = wire.Settle(session=self._session, epoch=self._epoch, duration_s=duration_s)
        self._step = self._ask(request, wire.Step)
        return self._step

    def end(self) -> wire.Ended:
        """Give authority back."""
        ended = self._ask(wire.End(session=self._session, epoch=self._epoch), wire.Ended)
        self._guard, self._step = None, None
        return ended

    def render(self, camera: str, width: int = 640, height: int = 480) -> wire.Picture:
        """A picture of the present; empty when the world cannot render."""
        return self._ask(wire.Render(camera=camera, width=width, height=height), wire.Picture, LOAD_TIMEOUT_S)

    def save_model(self, folder: Path) -> None:
        """Let the world write its compiled model into `folder`."""
        self._ask(wire.SaveModel(folder=str(folder)), wire.Ack, LOAD_TIMEOUT_S)

    def _ask(self, request: wire.Request, expected: type[ReplyT], timeout_s: float = REPLY_TIMEOUT_S) -> ReplyT:
        try:
            wire.send(self._connection, request)
        except OSError as error:
            raise ExecutionError("TARGET_LOST", "the world process closed the connection") from error
        reply = wire.receive_reply(self._connection, timeout_s)
        if isinstance(reply, wire.Refused):
            message = f"the target refused {type(request).__name__}: {reply.message}"
            raise CommandRefused(reply.code, message, "target")
        if not isinstance(reply, expected):
            raise ExecutionError("PROTOCOL_BROKEN", f"{type(request).__name__} was answered by {type(reply).__name__}")
        return reply
