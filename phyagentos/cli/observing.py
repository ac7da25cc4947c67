"""Looking at runs from outside: `status`, `runs`, `logs`."""

from collections.abc import Iterator
from typing import Annotated

import msgspec
import typer

from phyagentos.cli.explaining import Space
from phyagentos.cli.outcome import print_result
from phyagentos.cli.reply import Reply
from phyagentos.operations.logs import iter_log_lines
from phyagentos.operations.status import WorkspaceStatus, list_runs, read_status


def status(workspace: Space) -> Reply[WorkspaceStatus]:
    """Show how a workspace stands: its runtime, emergency stop, goals, sessions, and what each worker does."""
    found = read_status(workspace)
    return Reply(found, "\n".join(_render(found)))


def runs() -> Reply[tuple[WorkspaceStatus, ...]]:
    """List the workspaces of this folder, the newest first, and those that run elsewhere."""
    found = list_runs()
    none = "no workspace in workspaces/; `paos run GRAPH` makes one"
    return Reply(found, "\n".join(next(_render(each)) for each in found) or none)


def logs(
    workspace: Space,
    name: Annotated[str, typer.Argument(help="One log: agent, watch, worker-TARGET, world-TARGET; all without.")] = "",
    follow: Annotated[bool, typer.Option("--follow", "-f", help="Go on with what is written, until Ctrl-C.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object a line.")] = False,
) -> None:
    """Print what the processes of a run have printed."""
    for each in iter_log_lines(workspace, name, follows=follow):
        plain = each.line if name else f"{each.log}: {each.line}"
        print_result(msgspec.json.encode(each).decode() if as_json else plain)


def _render(found: WorkspaceStatus) -> Iterator[str]:
    """One line, then those of a latched stop and of each worker."""
    parts = ["running" if found.is_running else "not running", *(["emergency stop"] if found.latch else [])]
    parts += [f"{goal} {verdict}" for goal, verdict in found.goals.items()] or ["no goal"]
    yield f"{found.workspace}: {', '.join([*parts, *(f'{n} {each}' for each, n in found.sessions.items())])}"
    if found.latch is not None:
        yield f"  emergency stop by {found.latch.by or '?'}: {found.latch.reason or 'no reason given'}"
    for goal, again in found.open_goals.items() if not found.is_running else ():
        yield f"  {goal} has no verdict yet; continue it: {again}"
    for each in found.questions:
        shown = f" ({', '.join(each.pictures)})" if each.pictures else ""
        yield f"  question: {each.question} `paos answer {each.subject} yes|no -w {found.workspace}`{shown}"
    for beat in found.workers:
        doing = f"{beat.session} {beat.leaf}, {beat.sim_time_s:.1f} s simulated" if beat.session else ""
        yield f"  {beat.target}: {beat.phase} {doing}".rstrip()
