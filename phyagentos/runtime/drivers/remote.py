"""A target behind a connection (`driver: remote`): another process or machine that serves the same wire.

It is served there under its own authority, receive log, stops and deadman: it halts when this side disconnects.
"""

import contextlib
import math
from collections.abc import Mapping
from typing import Any

import msgspec
from typing_extensions import override

from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.channel import Channel
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.driver import TargetDriver
from phyagentos.runtime.targets.handshake import mint

SLOW_REPLY_S = 120.0  # without a beat: a scene that compiles, pictures of many cameras


class RemoteDriver(TargetDriver):
    """One target that is served elsewhere, over an open channel; tokens are minted from its `key`.

    Raises:
        ExecutionError: `TARGET_LOST` from every method when the target is gone or silent; else its own refusals.
    """

    NAME = "remote"

    def __init__(self, profile: TargetProfile, channel: Channel, key: bytes) -> None:
        self.profile, self._channel, self._key = profile, channel, key
        self._session, self._epoch = "", 0
        self._time_s = math.nan
        self._step: wire.Step | None = None  # not reported yet
        self._is_moving = False
        self._lost: ExecutionError | None = None
        self._n_sent = 0  # requests without a reply

    @property
    @override
    def time_s(self) -> float:
        return self._time_s

    @property
    @override
    def is_moving(self) -> bool:
        return self._is_moving

    @override
    def describe(self) -> wire.Description:
        there = self._ask(wire.Describe(), wire.Description)
        return msgspec.structs.replace(there, driver=f"{self.NAME}/{there.driver}")

    @override
    def load(self, request: wire.LoadScene) -> wire.Loaded:
        loaded = self._ask(request, wire.Loaded, SLOW_REPLY_S)
        self.observe(truth=False)  # reads its time
        return loaded

    @override
    def begin(self, session: str, epoch: int) -> None:
        self._ask(wire.Begin(session, epoch, mint(self._key, session, epoch)), wire.Ack)
        self._session, self._epoch, self._step, self._is_moving = session, epoch, None, False

    @override
    def end(self) -> tuple[wire.RecordedFault, ...]:
        session, self._session, self._is_moving = self._session, "", False
        ended = self._ask(wire.End(session=session, epoch=self._epoch), wire.Ended)
        self._time_s = ended.time_s
        return ended.faults

    @override
    def observe(self, *, truth: bool) -> wire.Observation:
        observation = self._ask(wire.Observe(truth=truth), wire.Observation)
        self._time_s = observation.time_s
        return observation

    @override
    def report(self) -> wire.Step:
        step, self._step = self._step, None
        if step is not None:
            return msgspec.structs.replace(step, stopped="")  # returned by `apply`
        now = self.observe(truth=False)
        return wire.Step(time_s=now.time_s, target=now.target, tracking_error_rad=0.0)

    @override
    def snapshot(self) -> wire.Artefact | None:
        return self._ask(wire.Observe(snapshot=True), wire.Observation).snapshot

    @override
    def capture(self, request: wire.Capture) -> wire.Frames:
        return self._ask(request, wire.Frames, SLOW_REPLY_S)

    @override
    def announce(self, motion: wire.Announce) -> str:
        return self._ask(motion, wire.Admission).blocked_by

    @override
    def apply(self, command: wire.Command) -> str:
        step = self._move(command)
        self._is_moving = not step.stopped and bool(command.qd_rad_s[-1].any())
        return step.stopped

    @override
    def hold(self, duration_s: float) -> None:
        if self._session:  # between sessions it holds by itself
            self._move(wire.Settle(session=self._session, epoch=self._epoch, duration_s=duration_s))
            self._is_moving = False

    @override
    def halt(self, category: int = 2) -> None:
        if self._session:
            self._move(wire.Halt(session=self._session, epoch=self._epoch, category=category))
            self._is_moving = False

    @override
    def invoke_tool(self, name: str, arguments: Mapping[str, Any]) -> wire.ToolResult:
        request = wire.InvokeTool(name=name, arguments=dict(arguments), session=self._session, epoch=self._epoch)
        return self._ask(request, wire.ToolResult, SLOW_REPLY_S)

    @override
    def send_ahead(self, request: wire.Request) -> bool:
        with contextlib.suppress(ExecutionError):  # no reply will come
            wire.send_request(self._channel, request)
        self._n_sent += 1
        return True

    @override
    def close(self) -> None:
        """Disconnect; the target there halts and ends the authority."""
        self._channel.close()

    def _move(self, request: wire.Command | wire.Settle | wire.Halt) -> wire.Step:
        """A request that takes time; the maximum contact force is kept until it is reported."""
        step = self._ask(request, wire.Step)
        both = (step.contact_force_n, self._step.contact_force_n if self._step is not None else None)
        forces = [force for force in both if force is not None]
        self._step = msgspec.structs.replace(step, contact_force_n=max(forces, default=None))
        self._time_s = step.time_s
        return step

    def _ask(self, request: wire.Request, expected: type[wire.ReplyT], silence_s: float = 0.0) -> wire.ReplyT:
        """The reply; nothing is ever sent twice, and a lost target stays lost for the first reason."""
        if self._lost is not None:
            raise self._lost
        if not self._n_sent:
            self.send_ahead(request)
        self._n_sent -= 1
        silence_s = max(silence_s, self.profile.silence_max_s)
        reply: wire.Reply = wire.Beat()
        try:
            while isinstance(reply, wire.Beat | wire.Description) and not isinstance(reply, expected):  # of an end
                reply = wire.await_reply(self._channel, silence_s, self.is_ending, is_last=not self._n_sent)
        except ExecutionError as error:
            where = f"{self.profile.target!r} at {self.profile.endpoint or 'its endpoint'}"
            reason = error.message
            self._lost = ExecutionError(error.code, f"{type(request).__name__} to {where}: {reason}")
            raise self._lost from error
        return wire.require(request, reply, expected)
