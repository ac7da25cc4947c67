"""Commands that stop: `cancel`, `pause`, `resume`, `estop`; each drops a file as any tool could.

Only the end of a goal is a record: every agent that continues the goal must read it.
"""

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

import typer

from phyagentos.cli.outcome import Exit, ExitCode, print_result
from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError, PhyAgentOSError, format_names
from phyagentos.operations.workspaces import find_running, read_ledger
from phyagentos.protocol.documents.plain_text import clean
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

_READ, _WRITTEN = ("sessions",), "signals"  # parts of a workspace: what lies in others holds up no stop

Which = Annotated[str, typer.Argument(metavar="SESSION|all")]
Reason = Annotated[str, typer.Option(help="Why; it is recorded.", callback=clean)]
Space = Annotated[Path | None, typer.Option("--workspace", "-w", help="Its folder; every one that runs by default.")]


def cancel(
    session: Annotated[str, typer.Argument(metavar="SESSION|GOAL|all")], workspace: Space = None, reason: Reason = ""
) -> None:
    """Ask for an end: the robot is halted, then the session is cancelled; of a goal, every session of it."""
    _reach(workspace, lambda each: end(session, each, reason))


def end(session: str, workspace: Path, reason: str, by: str = "paos cancel") -> str:
    """Ask for the end of a session, of a goal, or of all; what was done."""
    # a damaged journal must not hold up a stop
    ledger = Ledger() if session == "all" else read_ledger(workspace, parts=_READ)
    if (goal := ledger.goals.get(GoalId(session))) is not None:
        done = [_cancel_goal(goal, workspace, reason, by)]
        for status in ledger.live_sessions():
            if status.contract.goal == goal.id:
                done += [_drop(Signal(kind="cancel", session=status.contract.id, by=by, reason=reason), workspace)]
        return "\n".join(done)
    return request("cancel", session, workspace, reason, by)


def pause(session: Which, workspace: Space = None, reason: Reason = "") -> None:
    """Let a running session rest at the end of its present motion, until `resume`; its time limits go on."""
    _reach(workspace, lambda each: request("pause", session, each, reason))


def resume(session: Which, workspace: Space = None) -> None:
    """Let a paused session go on."""
    _reach(workspace, lambda each: request("resume", session, each))


def estop(
    workspace: Space = None,
    reason: Reason = "",
    reset: Annotated[bool, typer.Option("--reset", help="Let targets move again; needs --reason.")] = False,
) -> None:
    """Stop every target at once; it stays latched, over restarts, until `--reset`, which needs --workspace."""
    if not reset:
        _reach(workspace, lambda each: stop_all(each, reason))
    elif workspace is None:
        raise Exit(ExitCode.INVALID_INPUT, "paos estop --reset: name the workspace that may move again: --workspace")
    else:
        kept = latches.reset(Workspace.open(workspace, _WRITTEN).signals.parent, reason, SystemClock())
        print_result(f"reset; the former latch is kept in {kept}")


def stop_all(workspace: Path, reason: str, by: str = "paos estop") -> str:
    """Latch the emergency stop of a workspace; what was done. Raises ExecutionError `LATCH_UNWRITABLE`."""
    signals, doubt = Workspace.open(workspace, _WRITTEN).signals.parent, ""
    try:
        latches.latch(signals, latches.Latch(by=by, reason=reason, at=SystemClock().wall_iso()))
    except OSError as error:
        if not latches.is_latched(signals):
            raise ExecutionError("LATCH_UNWRITABLE", f"{signals}: {error}; use the stop of the robot itself") from error
        doubt = f"latched, but the disk did not confirm it ({error}): a restart of the machine may forget it\n"
    again = f"`paos estop --reset --reason … -w {signals.parent}` lets targets move again"
    return f"{doubt}latched: {signals / latches.LATCH}; {again}"


def _reach(workspace: Path | None, act: Callable[[Path], str]) -> None:
    """Act on the given workspace, or on every one that runs, where at least one must know the session; print it."""
    places = [workspace] if workspace is not None else find_running()
    failed: list[Exit | PhyAgentOSError] = []
    for each in places:
        try:
            print_result(act(each))
        except (Exit, PhyAgentOSError) as error:  # the others are to stop all the same
            failed.append(error)
    if not places:
        raise Exit(ExitCode.INVALID_INPUT, "no workspace is running; name one: --workspace")
    for each_error in failed:
        unknown = any(each.code == "UNKNOWN_SESSION" for each in getattr(each_error, "problems", ()))
        if not (unknown or isinstance(each_error, Exit)) or len(failed) == len(places):
            raise each_error


def _cancel_goal(goal: GoalStatus, workspace: Path, reason: str, by: str) -> str:
    """Record that it is to end; one that was cancelled before may still have sessions that live."""
    if goal.verdict:
        raise Exit(ExitCode.INVALID_INPUT, f"{goal.id}: its verdict {goal.verdict!r} is final")
    with contextlib.closing(Journal(workspace, side=Side.OPERATOR, by=by, clock=SystemClock())) as journal:
        ledger = journal.open_ledger()
        if not goal.is_cancelled:
            body = {"reason": reason or f"asked for by {by}"}
            journal.commit([Entry(f"{GOAL_PREFIX}{goal.id}", GoalEvent.GOAL_CANCELLED, body)])
        cancel_unheld(goal.id, ledger, journal)
    return f"cancelled goal {goal.id}"


def request(
    kind: Literal["cancel", "pause", "resume"], session: str, workspace: Path, reason: str = "", by: str = ""
) -> str:
    """Drop a request about a session, or all; what was done."""
    id = EVERY_SESSION
    if session != "all":
        ledger = read_ledger(workspace, parts=_READ)
        id = get_session(session, ledger.sessions)
        if (state := ledger.sessions[id].state) in FINAL_STATES:
            live = [status.contract.id for status in ledger.live_sessions()]
            possible = f"live sessions are {format_names(live)}" if live else "no session is live"
            raise Exit(ExitCode.INVALID_INPUT, f"{id}: its state {state!r} is final; {possible}")
    return _drop(Signal(kind=kind, session=id, by=by or f"paos {kind}", reason=reason), workspace)


def _drop(signal: Signal, workspace: Path) -> str:
    path = drop_signal(Workspace.open(workspace, _WRITTEN).signals, signal, SystemClock())
    return f"asked to {signal.kind} {signal.session}: {path}"
