"""Stops: an end, a rest, a person at the arm, the emergency stop; each drops a file as any tool could.

Only the end of a goal is a record: every agent that continues the goal must read it.
"""

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import msgspec

from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError, ExecutionError, PhyAgentOSError, format_names
from phyagentos.operations.workspaces import find_running, read_ledger
from phyagentos.protocol.capabilities.registries import get_registered_target
from phyagentos.protocol.sessions import estop as latches
from phyagentos.protocol.sessions.lifecycle import FINAL_STATES, Side
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.protocol.sessions.stop_signals import EVERY_SESSION, Signal, drop_signal
from phyagentos.protocol.sessions.tasks import GoalStatus
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.admission import GOAL_PREFIX, Entry, GoalEvent
from phyagentos.store.journal import Journal, cancel_unheld
from phyagentos.store.ledger import Ledger
from phyagentos.store.subjects import get_session

ALL = "all"
_READ, _WRITTEN = ("sessions",), "signals"  # parts of a workspace: damage to others must not hold up a stop


class StopRequest(msgspec.Struct, frozen=True, kw_only=True):
    """One request that was made.

    Attributes:
        subject: The session or goal that it is about; `*` for all.
        file: Where it was written; empty for the end of a goal, which is a record.
        warning: What was not confirmed.
    """

    workspace: str
    kind: Literal["cancel", "pause", "resume", "take_over", "estop", "reset"]
    subject: str = EVERY_SESSION
    file: str = ""
    warning: str = ""


class Stopped(msgspec.Struct, frozen=True, kw_only=True):
    """What was requested, and what failed in other workspaces."""

    requests: tuple[StopRequest, ...]
    failed: tuple[str, ...] = ()


def cancel(subject: str, root: Path | None = None, *, reason: str = "", by: str = "paos cancel") -> Stopped:
    """Ask for the end of a session, of a goal with every session of it, or of `all`.

    Without a workspace, this and the other stops reach every one that runs on this machine, of which at least one must
    know the subject. Raises DefinitionError `NOT_RUNNING`, `UNKNOWN_NAME`, `ALREADY_OVER`; ExecutionError.
    """
    return _reach(root, lambda each: _cancel(subject, each, reason, by))


def pause(session: str = ALL, root: Path | None = None, *, reason: str = "", by: str = "paos pause") -> Stopped:
    """Ask a session, or all, to rest at the end of the present motion."""
    return _reach(root, lambda each: (_request(Signal(kind="pause", by=by, reason=reason), session, each),))


def resume(session: str = ALL, root: Path | None = None, *, by: str = "paos resume") -> Stopped:
    """Let a paused session, or all, go on."""
    return _reach(root, lambda each: (_request(Signal(kind="resume", by=by), session, each),))


def take_over(
    session: str, root: Path | None = None, *, leader: str, speaks: Literal["tool", "joints"] = "tool", by: str
) -> Stopped:
    """Let a person move the arm of a running session, until the policy server at `leader` says that it is done.

    The session ends then and is judged like any other. The server is on this machine (`tcp://127.0.0.1:PORT`); its rows
    are steps of the `tool` in the world (x, y, z [m], rotation vector [rad], opening [m]), ten a second, or `joints` as
    the target takes them, one a control period.
    """
    request = Signal(kind="take_over", by=by, leader=leader, speaks=speaks)
    return _reach(root, lambda each: (_request(request, session, each),))


def find_opening(session: str, root: Path | None = None) -> float:
    """How far the gripper of a session's target opens [m]; raises as `cancel`."""
    for each in [root] if root is not None else find_running():
        sessions = read_ledger(each, parts=_READ).sessions
        if root is not None or session in sessions:
            target = sessions[get_session(session, sessions)].contract.target
            registry = Workspace.open(each, _WRITTEN).target_registry
            return get_registered_target(registry, target).gripper.max_width_m
    raise DefinitionError.of("NOT_RUNNING", session, "no workspace with it is running", "a session of `paos status`")


def estop(root: Path | None = None, *, reason: str = "", by: str = "paos estop") -> Stopped:
    """Latch the emergency stop; raises ExecutionError `WRITE_FAILED` where it is not latched."""
    return _reach(root, lambda each: (_latch(each, reason, by),))


def reset_estop(root: Path, *, reason: str) -> Stopped:
    """Let the targets of a workspace move again; raises DefinitionError `ALREADY_OVER`, `MISSING_VALUE`."""
    kept = latches.reset(Workspace.open(root, _WRITTEN).signals.parent, reason, SystemClock())
    return Stopped(requests=(StopRequest(workspace=str(root), kind="reset", file=str(kept)),))


def _reach(root: Path | None, act: Callable[[Path], tuple[StopRequest, ...]]) -> Stopped:
    """Act on the given workspace, or on every one that runs; one that fails holds up no other."""
    places = [root] if root is not None else find_running()
    if not places:
        raise DefinitionError.of("NOT_RUNNING", "--workspace", "no workspace is running", "the folder of a run")
    done: list[StopRequest] = []
    failed: list[PhyAgentOSError] = []
    for each in places:
        try:
            done += act(each)
        except PhyAgentOSError as error:
            failed.append(error)
    if len(failed) == len(places):
        raise failed[0]
    texts = [str(error) for error in failed if not _is_of_another(error)]
    return Stopped(requests=tuple(done), failed=tuple(texts))


def _is_of_another(error: PhyAgentOSError) -> bool:
    problems = error.problems if isinstance(error, DefinitionError) else ()
    return any(each.kind == "session" or each.code == "ALREADY_OVER" for each in problems)


def _cancel(subject: str, root: Path, reason: str, by: str) -> tuple[StopRequest, ...]:
    ledger = Ledger() if subject == ALL else read_ledger(root, parts=_READ)  # damage must not hold up a stop
    goal = ledger.goals.get(GoalId(subject))
    if goal is None:
        return (_request(Signal(kind="cancel", by=by, reason=reason), subject, root),)
    live = [status.contract.id for status in ledger.live_sessions() if status.contract.goal == goal.id]
    signals = [Signal(kind="cancel", session=id, by=by, reason=reason) for id in live]
    return (_cancel_goal(goal, root, reason, by), *(_drop(each, root) for each in signals))


def _cancel_goal(goal: GoalStatus, root: Path, reason: str, by: str) -> StopRequest:
    """Record that it is to end; one that was cancelled before may still have sessions that live."""
    if goal.verdict:
        raise DefinitionError.of("ALREADY_OVER", goal.id, f"its verdict {goal.verdict!r} is final")
    with contextlib.closing(Journal(root, side=Side.OPERATOR, by=by, clock=SystemClock())) as journal:
        ledger = journal.open_ledger()
        if not goal.is_cancelled:
            body = {"reason": reason or f"requested by {by}"}
            journal.commit([Entry(f"{GOAL_PREFIX}{goal.id}", GoalEvent.GOAL_CANCELLED, body)])
        cancel_unheld(goal.id, ledger, journal)
    return StopRequest(workspace=str(root), kind="cancel", subject=goal.id)


def _request(signal: Signal, session: str, root: Path) -> StopRequest:
    id = EVERY_SESSION
    if session != ALL:
        ledger = read_ledger(root, parts=_READ)
        id = get_session(session, ledger.sessions)
        if (state := ledger.sessions[id].state) in FINAL_STATES:
            live = [status.contract.id for status in ledger.live_sessions()]
            possible = f"a live session: {format_names(live)}"
            raise DefinitionError.of("ALREADY_OVER", id, f"its state {state!r} is final", possible)
    return _drop(msgspec.structs.replace(signal, session=id), root)


def _drop(signal: Signal, root: Path) -> StopRequest:
    path = drop_signal(Workspace.open(root, _WRITTEN).signals, signal, SystemClock())
    return StopRequest(workspace=str(root), kind=signal.kind, subject=signal.session, file=str(path))


def _latch(root: Path, reason: str, by: str) -> StopRequest:
    signals, warning = Workspace.open(root, _WRITTEN).signals.parent, ""
    try:
        latches.latch(signals, latches.Latch(by=by, reason=reason, at=SystemClock().wall_iso()))
    except OSError as error:
        if not latches.is_latched(signals):
            raise ExecutionError("WRITE_FAILED", f"{signals}: {error}; use the stop of the robot itself") from error
        warning = f"latched, but the disk did not confirm it ({error}): a restart of the machine may forget it"
    return StopRequest(workspace=str(root), kind="estop", file=str(signals / latches.LATCH), warning=warning)
