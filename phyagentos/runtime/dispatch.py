"""What the watchdog asks of a worker process, and what it hears back. One session at a time."""

import msgspec

from phyagentos.errors import Problem
from phyagentos.protocol.channel import Channel
from phyagentos.protocol.sessions import Ended, Execution, Session
from phyagentos.runtime.adapter_plan import AdapterPlan, TargetToolManifest, Trial


class Check(msgspec.Struct, frozen=True, tag=True):
    """Load the session's scene if need be and check the contract against the live target. Answer: `Checked`.

    Attributes:
        restore: File with the state vector to start from (a rerun), empty for an ordinary session.
        thorough: Try out the motions of every session, paths too (`paos preflight`).
    """

    session: Session
    epoch: int
    restore: str = ""
    thorough: bool = False


class Run(msgspec.Struct, frozen=True, tag=True):
    """Carry out the session that was checked last. Answer: `Finished`."""

    session: Session
    epoch: int
    evidence: str


class Stop(msgspec.Struct, frozen=True, tag=True):
    """Bring the running session to an end. No answer of its own; `Finished` comes sooner.

    Attributes:
        reason: `cancelled`, `timed_out` or `stalled`.
    """

    session: str
    reason: str


class Pause(msgspec.Struct, frozen=True, tag=True):
    """Let the running session rest at the end of its present motion until `Resume` or `Stop`."""

    session: str


class Resume(msgspec.Struct, frozen=True, tag=True):
    """Let a paused session go on."""

    session: str


class Reconcile(msgspec.Struct, frozen=True, tag=True):
    """Observe the world for a session whose runner was lost. Answer: `Finished`.

    Attributes:
        ended: What was lost.
    """

    session: Session
    epoch: int
    evidence: str
    reason: str
    ended: Ended = Ended.RUNNER_LOST


class Ready(msgspec.Struct, frozen=True, tag=True):
    """The worker, its planner and its target stand; sent once, unasked."""


class Checked(msgspec.Struct, frozen=True, tag=True):
    """Result of preflight: a plan, or every problem.

    Attributes:
        plan: None when there is any problem.
        trials: Of the dry run, where one was made.
        ms: What the examination cost, wall time [ms].
    """

    session: str
    plan: AdapterPlan | None
    tools: TargetToolManifest | None
    problems: tuple[Problem, ...] = ()
    trials: tuple[Trial, ...] = ()
    ms: float = 0.0


class Finished(msgspec.Struct, frozen=True, tag=True):
    """The session left `running`; the target is at rest and observed, unless it was lost.

    Attributes:
        is_target_lost: Nobody could look at the world; it must be replaced before anybody can.
    """

    session: str
    execution: Execution
    is_target_lost: bool = False


ToWorker = Check | Run | Stop | Pause | Resume | Reconcile
FromWorker = Ready | Checked | Finished

_ENCODER = msgspec.msgpack.Encoder()
_TO_WORKER: msgspec.msgpack.Decoder[ToWorker] = msgspec.msgpack.Decoder(ToWorker)
_FROM_WORKER: msgspec.msgpack.Decoder[FromWorker] = msgspec.msgpack.Decoder(FromWorker)


def send(connection: Channel, message: ToWorker | FromWorker) -> None:
    """Send one message."""
    connection.send_bytes(_ENCODER.encode(message))


def receive_order(connection: Channel) -> ToWorker:
    """Wait for the watchdog; raises EOFError when it is gone."""
    return _TO_WORKER.decode(connection.recv_bytes())


def receive_answer(connection: Channel) -> FromWorker:
    """Wait for the worker; raises EOFError when it is gone."""
    return _FROM_WORKER.decode(connection.recv_bytes())
