"""A target behind a connection (`driver: remote`): another process or machine that serves the same wire.

It is served there under its own authority, receive log, stops and deadman: it halts when this side disconnects.
"""

import contextlib
import math

import msgspec
from typing_extensions import override

from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.channel import Channel
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.driver import VERBS, TargetPort, Trait
from phyagentos.runtime.targets.handshake import mint

SLOW_REPLY_S = 120.0  # without a sign of life: a scene that compiles, pictures of many cameras
BEATS = 6  # so many times the longest silence a request takes at most with signs of life, unless time is shared
ENDING_MAX_S = 3.0  # for the reply once the session is to end: less than a worker has
STRAYS_MAX = 8  # replies to requests to end that may stand before the one that is awaited


class RemoteDriver(TargetPort):
    """One target that is served elsewhere, over an open channel; tokens are minted from its `key`.

    Raises:
        ExecutionError: `TARGET_LOST` from every method when the target is gone or silent; else its own refusals.
    """

    NAME = "remote"

    def __init__(self, profile: TargetProfile, channel: Channel, key: bytes) -> None:
        self.profile, self._channel, self._key = profile, channel, key
        self._session, self._epoch = "", 0
        self._time_s = math.nan
        self._force_n: float | None = None  # maximum contact force of motions that no reply has reported
        self._is_moving = False
        self._lost: ExecutionError | None = None
        self._n_sent = 0  # requests without a reply
        self._shares_time = False

    @property
    @override
    def time_s(self) -> float:
        return self._time_s

    @property
    @override
    def is_moving(self) -> bool:
        return self._is_moving

    @override
    def carry_out(self, request: wire.RequestFor[wire.ReplyT]) -> wire.ReplyT:
        sent: wire.Request = request
        if isinstance(sent, wire.Begin):
            sent = msgspec.structs.replace(sent, token=mint(self._key, sent.session, sent.epoch))
        elif isinstance(sent, wire.InvokeTool):
            sent = msgspec.structs.replace(sent, session=self._session, epoch=self._epoch)
        elif isinstance(sent, wire.End):
            self._session, self._is_moving = "", False
        return wire.require(type(request), self._note(sent, self._await(sent)))

    def _note(self, request: wire.Request, reply: wire.Reply) -> wire.Reply:
        """The reply as it is passed on, after what it says of the target is noted."""
        match reply:
            case wire.Description():
                self._shares_time = reply.shares_time
                return msgspec.structs.replace(reply, driver=f"{self.NAME}/{reply.driver}")
            case wire.Loaded():
                self.carry_out(wire.Observe())  # reads its time
            case wire.Ack() if isinstance(request, wire.Begin):
                self._session, self._epoch, self._force_n, self._is_moving = request.session, request.epoch, None, False
            case wire.Observation() | wire.Ended():
                self._time_s = reply.time_s
            case wire.Step():
                is_commanded = isinstance(request, wire.Command) and bool(request.qd_rad_s[-1].any())
                self._time_s, self._is_moving = reply.time_s, is_commanded and not reply.stopped
                forces = [force for force in (reply.contact_force_n, self._force_n) if force is not None]
                self._force_n = None
                return msgspec.structs.replace(reply, contact_force_n=max(forces, default=None))
        return reply

    @override
    def send_ahead(self, request: wire.Request) -> bool:
        with contextlib.suppress(ExecutionError):  # no reply will come
            wire.send_request(self._channel, request)
        self._n_sent += 1
        return True

    @override
    def hold(self, duration_s: float) -> None:
        if self._session:  # between sessions it holds by itself
            self._force_n = self.carry_out(wire.Settle(self._session, self._epoch, duration_s)).contact_force_n

    @override
    def halt(self, category: int = 2) -> None:
        if self._session:
            self._force_n = self.carry_out(wire.Halt(self._session, self._epoch, category)).contact_force_n

    @override
    def emergency_stop(self) -> None:
        if self._session:
            halt = wire.Halt(self._session, self._epoch, category=1, is_emergency=True)
            self._force_n = self.carry_out(halt).contact_force_n

    @override
    def end(self) -> tuple[wire.RecordedFault, ...]:
        return self.carry_out(wire.End(self._session, self._epoch)).faults

    @override
    def close(self) -> None:
        """Disconnect; the target there halts and ends the authority."""
        self._channel.close()

    def _await(self, request: wire.Request) -> wire.Reply:
        """The reply; nothing is ever sent twice, and a lost target stays lost for the first reason."""
        if self._lost is not None:
            raise self._lost
        if not self._n_sent:
            self.send_ahead(request)
        self._n_sent -= 1
        slow_s = SLOW_REPLY_S if Trait.SLOW in VERBS[type(request)].traits else 0.0
        silence_s = max(slow_s, self.profile.silence_max_s)
        expected = wire.find_expected(type(request))
        beats_max_s = wire.SHARED_TIMEOUT_S if self._shares_time else BEATS * silence_s
        ending_max_s = wire.SHARED_TIMEOUT_S if self._shares_time else ENDING_MAX_S
        try:
            for _ in range(STRAYS_MAX):
                reply = wire.await_reply(
                    self._channel,
                    silence_s,
                    self.is_ending,
                    is_last=not self._n_sent,
                    beats_max_s=beats_max_s,
                    ending_max_s=ending_max_s,
                )
                if isinstance(reply, expected) or not isinstance(reply, wire.KeepAlive | wire.Description):
                    break
        except ExecutionError as error:
            where = f"{self.profile.target!r} at {self.profile.endpoint or 'its endpoint'}"
            reason = error.message
            self._lost = ExecutionError(error.code, f"{type(request).__name__} to {where}: {reason}")
            raise self._lost from error
        return reply
