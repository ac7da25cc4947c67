"""RUNTIME_SIGNAL.md: the state of the runtime, the last heartbeat of each worker, and the requests, for people.

The journal, not this document, holds the states of sessions.
"""

from enum import StrEnum

import msgspec

from phyagentos.protocol.capabilities.targets import Health
from phyagentos.protocol.documents.document import DocumentFormat
from phyagentos.protocol.sessions.heartbeats import Heartbeat


class RuntimeState(StrEnum):
    """Whether a runtime serves the workspace."""

    NOT_STARTED = "not_started"
    """None has been started."""
    RUNNING = "running"
    """One is running, if the time of the document is recent."""
    ENDED = "ended"
    """The last one ended in order."""


class RequestState(StrEnum):
    """What became of a request."""

    WAITING = "waiting"
    """Not processed yet."""
    TAKEN = "taken"
    """It was read and acted upon; what it did is in the log."""
    REJECTED = "rejected"
    """Unreadable; the reason stands beside it in `signals/rejected/`."""


class WorkerSign(Heartbeat, frozen=True, kw_only=True):
    """Latest heartbeat of one target's worker.

    Attributes:
        health: How the worker is.
    """

    health: Health


class Request(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One file in `signals/`.

    Attributes:
        file: Its name.
        state: What became of it.
        kind: `cancel`, `pause`, `resume`, `take_over` or `estop`; empty when it cannot be read.
        session: Which session, `*` for all.
        by: Who asks.
        reason: Why.
        at: UTC wall time, where it names one.
        leader: Of `take_over`, where the person's commands come from.
        speaks: Of `take_over`, what these are: steps of the `tool`, or `joints`.
    """

    file: str
    state: RequestState
    kind: str = ""
    session: str = ""
    by: str = ""
    reason: str = ""
    at: str = ""
    leader: str = ""
    speaks: str = "tool"


class Signs(msgspec.Struct, frozen=True, kw_only=True):
    """The block of RUNTIME_SIGNAL.md.

    Attributes:
        runtime: Whether a runtime serves the workspace.
        at: UTC wall time of this document; renewed at least every ten seconds while a runtime runs.
        workers: By target.
        requests: The latest ones, newest last.
    """

    runtime: RuntimeState
    at: str = ""
    workers: dict[str, WorkerSign] = {}
    requests: tuple[Request, ...] = ()


RUNTIME_SIGNAL = DocumentFormat(
    name="runtime_signal",
    file="RUNTIME_SIGNAL.md",
    summary="Whether a runtime is running, the latest heartbeat of each worker, and which requests were made.",
    block=Signs,
    headings=("Signs",),
)
