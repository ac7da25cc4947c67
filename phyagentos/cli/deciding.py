"""What an operator decides about goals: `approve` and `deny` what is proposed, `amend` what is pursued."""

import getpass
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from phyagentos.agent.mission.report import CANCELLED
from phyagentos.assembly.project import admit_python
from phyagentos.cli.arguments import Overrides, TrustPython
from phyagentos.cli.explaining import Space
from phyagentos.cli.outcome import Exit, ExitCode, print_note
from phyagentos.cli.reply import Reply
from phyagentos.cli.running import WhichMemory
from phyagentos.cli.stopping import Reason
from phyagentos.operations import amend as amending
from phyagentos.operations import approve as approving
from phyagentos.operations.amend import Amendment
from phyagentos.operations.approve import Decided, WaitingProposal

_POLICY_HELP = "Decide by this file what asks for a policy, and run what it permits, until Ctrl-C."
_REASON_MAX = 100  # characters of a proposal's reason in a list


def approve(
    workspace: Space,
    name: Annotated[str, typer.Argument(metavar="PROPOSAL", help="Its name; without one, what waits is listed.")] = "",
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask; the name stands for the bytes.")] = False,
    policy: Annotated[Path | None, typer.Option("--policy", help=_POLICY_HELP, dir_okay=False)] = None,
    once_idle: Annotated[bool, typer.Option(help="With --policy: end when nothing asks for it.")] = False,
    reason: Reason = "",
    memory: WhichMemory = None,
    trust_python: TrustPython = False,
) -> Reply[tuple[WaitingProposal, ...] | tuple[Decided, ...]]:
    """Let a proposed goal run: shows it, asks, writes the approval, carries it out to its verdict."""
    if policy is None and not name:
        waiting = approving.list_proposals(workspace)
        return Reply(waiting, "\n".join(map(_describe_waiting, waiting)) or "no proposal waits")
    admit_python(workspace, is_trusted=trust_python, announce=print_note)
    if policy is not None:
        return _follow(workspace, policy, once_idle=once_idle)
    shown = approving.read_proposal(workspace, name)
    chosen = (f"  {node}: {skill} on {target}" for node, (skill, target) in shown.sessions.items())
    print_note("\n".join((shown.text, *chosen, f"sha256 {shown.sha256}")))
    if not yes and not typer.confirm("Let it move the robot?", err=True):
        raise Exit(ExitCode.INTERRUPTED, "nothing was decided; `paos deny` records a refusal")
    done = approving.approve(workspace, name, shown.sha256, by=getpass.getuser(), reason=reason, memory=memory)
    return Reply((done,), _describe_decision(done), code=ExitCode(done.report.exit_code if done.report else 0))


def deny(
    workspace: Space, name: Annotated[str, typer.Argument(metavar="PROPOSAL")], reason: Reason = ""
) -> Reply[Decided]:
    """Refuse a proposed goal; that is recorded, and its proposer can read why."""
    return Reply(approving.deny(workspace, name, by=getpass.getuser(), reason=reason), f"denied: {name}")


def amend(
    goal: Annotated[str, typer.Argument(metavar="GOAL", help="Its id, as TASK.md shows it.")],
    graph: Annotated[Path, typer.Argument(help="The whole graph as it shall be.")],
    workspace: Space,
    set_: Overrides = None,
    wait_s: Annotated[float, typer.Option("--wait", min=0.0, help="Longest wait for the agent's answer [s].")] = 10.0,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show the difference; ask for nothing.")] = False,
) -> Reply[Amendment]:
    """Change the graph of a goal that is pursued: what has begun stays, everything else may become other nodes."""
    found = amending.amend(workspace, goal, graph, overrides=set_ or (), wait_s=wait_s, dry_run=dry_run)
    lines, notes = [*_iter_changes(found)], list[str]()
    if found.answer:
        (notes if found.is_refused else lines).append(f"{goal}: {found.answer}")
    elif not dry_run:
        notes.append("asked for; the agent answers as soon as it goes on with this goal: TASK.md shows it")
    code = ExitCode.INVALID_INPUT if found.is_refused else ExitCode.GOAL_MET
    return Reply(found, "\n".join(lines), notes, code)


def _follow(workspace: Path, policy: Path, *, once_idle: bool) -> Reply[tuple[Decided, ...]]:
    print_note(f"decides by {policy} until Ctrl-C; what asks for a person waits for `paos approve`")
    done = approving.follow_policy(
        workspace, policy, lambda each: print_note(_describe_decision(each)), once_idle=once_idle
    )
    is_cancelled = any(each.report is not None and each.report.verdict == CANCELLED for each in done)
    return Reply(done, code=ExitCode.INTERRUPTED if is_cancelled else ExitCode.GOAL_MET)


def _describe_waiting(each: WaitingProposal) -> str:
    if each.problem:
        return f"{each.name}  {each.problem}"
    why = " ".join(each.reason.split())[:_REASON_MAX]
    return f"{each.name}  requested by {each.by} at {each.at}, for a {each.decider}: {why}"


def _describe_decision(each: Decided) -> str:
    if each.report is None:
        return f"{each.decision}: {each.proposal}  {each.reason}"
    return f"goal {each.report.goal}: {each.report.verdict}  {each.report.reason}"


def _iter_changes(found: Amendment) -> Iterator[str]:
    for name, node in found.difference.nodes.items():
        after = f" after {', '.join(node['after'])}" if node["after"] else ""
        yield f"{'+' if name in found.difference.added else '~'} {name}: {node['skill']} on {node['target']}{after}"
    yield from (f"- {name}" for name in found.difference.removed)
    for sign, sentences in (("-", found.difference.dropped), ("+", found.difference.gained)):
        yield from (f"{sign} {key} {text}" for key, text in sentences)
