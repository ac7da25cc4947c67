"""Commands that stop: `cancel`, `pause`, `resume`, `estop`."""

from pathlib import Path
from typing import Annotated

import typer

from phyagentos.cli.outcome import Exit, ExitCode
from phyagentos.cli.reply import Reply
from phyagentos.operations import stop
from phyagentos.operations.stop import Stopped, StopRequest
from phyagentos.protocol.documents.plain_text import clean

Which = Annotated[str, typer.Argument(metavar="SESSION|all")]
Reason = Annotated[str, typer.Option(help="Why; it is recorded.", callback=clean)]
Space = Annotated[Path | None, typer.Option("--workspace", "-w", help="Its folder; every one that runs by default.")]


def cancel(
    session: Annotated[str, typer.Argument(metavar="SESSION|GOAL|all")], workspace: Space = None, reason: Reason = ""
) -> Reply[Stopped]:
    """Ask for an end: the robot is halted, then the session is cancelled; of a goal, every session of it."""
    return show(stop.cancel(session, workspace, reason=reason))


def pause(session: Which, workspace: Space = None, reason: Reason = "") -> Reply[Stopped]:
    """Let a running session rest at the end of its present motion, until `resume`; its time limits go on."""
    return show(stop.pause(session, workspace, reason=reason))


def resume(session: Which, workspace: Space = None) -> Reply[Stopped]:
    """Let a paused session go on."""
    return show(stop.resume(session, workspace))


def estop(
    workspace: Space = None,
    reason: Reason = "",
    reset: Annotated[bool, typer.Option("--reset", help="Let targets move again; needs --reason.")] = False,
) -> Reply[Stopped]:
    """Stop every target at once; it stays latched, over restarts, until `--reset`, which needs --workspace."""
    if not reset:
        return show(stop.estop(workspace, reason=reason))
    if workspace is None:
        raise Exit(ExitCode.INVALID_INPUT, "paos estop --reset: name the workspace that may move again: --workspace")
    return show(stop.reset_estop(workspace, reason=reason))


def render_request(request: StopRequest) -> str:
    """What was requested, in a line."""
    match request.kind:
        case "estop":
            again = f"`paos estop --reset --reason … -w {request.workspace}` lets targets move again"
            return "\n".join([*filter(None, [request.warning]), f"latched: {request.file}; {again}"])
        case "reset":
            return f"reset; the former latch is kept in {request.file}"
    if not request.file:
        return f"cancelled goal {request.subject}"
    return f"asked to {request.kind.replace('_', ' ')} {request.subject}: {request.file}"


def show(found: Stopped) -> Reply[Stopped]:
    """What was requested, line by line; an internal error where another workspace failed."""
    code = ExitCode.INTERNAL_ERROR if found.failed else ExitCode.GOAL_MET
    return Reply(found, "\n".join(map(render_request, found.requests)), found.failed, code)
