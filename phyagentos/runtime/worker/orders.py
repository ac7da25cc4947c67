"""Messages between the watchdog and a worker process, which has one session at a time."""

from collections.abc import Sequence
from typing import Literal

import msgspec

from phyagentos.errors import Problem
from phyagentos.protocol.sessions.session import Ended, Execution, Session
from phyagentos.runtime.channel import Channel
from phyagentos.runtime.codec import Codec
from phyagentos.runtime.preflight.adapter_plan import Finding
from phyagentos.runtime.preflight.findings import locate

OBSERVERS = 20  # at most, lost in a row while they observe what one session left


class Check(msgspec.Struct, frozen=True, tag=True):
    """Load the session's scene if need be and check the contract against the live target. Answer: `Checked`.

    Attributes:
        restore: File with the state vector to start from (a rerun), empty for an ordinary session.
        thorough: Try out the motions of every session, paths too (`paos preflight`).
        may_reset: Whether another episode may end for this session (`ResetPolicy`).
    """

    session: Session
    epoch: int
    restore: str = ""
    thorough: bool = False
    may_reset: bool = True


class Run(msgspec.Struct, frozen=True, tag=True):
    """Open the bundle of the session that was checked last; carry it out from its first `Renew` on. Answer: `Finished`.

    `token` is that of the epoch, for the target (`handshake.mint`).
    """

    session: Session
    epoch: int
    evidence: str
    token: bytes = b""


class Renew(msgspec.Struct, frozen=True, tag=True):
    """Grant the running session a lease, or renew it; without one the worker brings its target to rest.

    It ends at `until_s` of this machine's monotonic clock [s]; a wall clock that jumps changes nothing.
    """

    until_s: float


class Stop(msgspec.Struct, frozen=True, tag=True):
    """End the running session. No answer of its own; `Finished` comes sooner.

    Attributes:
        reason: `cancelled`, `timed_out` or `stalled`.
        why: One sentence that names the limit; empty where none decided.
    """

    session: str
    reason: str
    why: str = ""


class Pause(msgspec.Struct, frozen=True, tag=True):
    """Let the running session rest at the end of its present motion until `Resume` or `Stop`."""

    session: str


class Resume(msgspec.Struct, frozen=True, tag=True):
    """Continue a paused session."""

    session: str


class TakeOver(msgspec.Struct, frozen=True, tag=True):
    """Let a person move the arm of the running session, until the server at `leader` says that it is done.

    Attributes:
        speaks: `tool`, steps of the tool, or `joints`, positions.
        by: Who.
    """

    session: str
    leader: str
    speaks: Literal["tool", "joints"]
    by: str = ""


class Reconcile(msgspec.Struct, frozen=True, tag=True):
    """Observe the world for a session whose runner was lost. Answer: `Finished`.

    Attributes:
        code: Under which the session ends; that of `ended` when empty.
        defect: Where Python of a person ended the runner.
        tokens: Of this epoch and of those after it: an earlier observer may have been lost too.
    """

    session: Session
    epoch: int
    evidence: str
    reason: str
    ended: Ended = Ended.RUNNER_LOST
    code: str = ""
    defect: str = ""
    tokens: tuple[bytes, ...] = (b"",) * OBSERVERS


class Ready(msgspec.Struct, frozen=True, tag=True):
    """Worker, planner and target are ready; sent once, without an order."""


class Checked(Finding, frozen=True, kw_only=True, tag=True):
    """What preflight found of a session, in answer to `Check`."""

    session: str

    def describe_grant(self) -> dict[str, object]:
        """Body of the start record; operations by name, since their schemas are the target's."""
        granted = self.tools.expose if self.tools is not None else ()
        return {"plan": msgspec.to_builtins(self.plan), "tools": {"expose": granted}}


class Finished(msgspec.Struct, frozen=True, tag=True):
    """The session left `running`; the target is at rest and observed, unless it was lost and must be replaced first."""

    session: str
    execution: Execution
    is_target_lost: bool = False


ToWorker = Check | Run | Renew | Stop | Pause | Resume | TakeOver | Reconcile
FromWorker = Ready | Checked | Finished

_ORDERS = Codec[ToWorker](ToWorker, "order")
_ANSWERS = Codec[FromWorker](FromWorker, "answer")
encode = _ORDERS.encode


def receive_order(connection: Channel) -> ToWorker:
    """Wait for the watchdog; raises EOFError when it is gone."""
    return _ORDERS.decode(connection.recv_bytes())


def receive_answer(connection: Channel) -> FromWorker:
    """Wait for the worker; raises EOFError when it is gone."""
    return _ANSWERS.decode(connection.recv_bytes())


def serve_refusals(control: Channel, problems: Sequence[Problem]) -> None:
    """Reject every session with the reasons why its worker cannot start; ends at any other order."""
    control.send_bytes(encode(Ready()))
    while True:
        try:
            order = receive_order(control)
        except (EOFError, OSError):
            return
        if not isinstance(order, Check):
            return
        located = tuple(locate(order.session, problems))
        control.send_bytes(encode(Checked(session=order.session.id, plan=None, tools=None, problems=located)))
