"""Commands of the operator about proposed goals: `approve` and `deny`. No tool of an agent reaches them.

An approval and its run are one command: nothing starts a robot because a file appears in a folder.
"""

import getpass
import hashlib
from datetime import datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from phyagentos.agent.tools.proposals import ApprovalPolicy, Proposals, Proposed, iter_objections, restrict
from phyagentos.assembly.approved_goals import carry_out, compile_proposed
from phyagentos.assembly.project import admit_python
from phyagentos.cli.arguments import TrustPython
from phyagentos.cli.explaining import Space
from phyagentos.cli.outcome import Exit, ExitCode, print_note, print_result
from phyagentos.cli.running import WhichMemory
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.plain_text import clean
from phyagentos.protocol.documents.schema import read_yaml, validate
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.watch import POLL_S, Watch

Name = Annotated[str, typer.Argument(metavar="PROPOSAL", help="Its name; without one, what waits is listed.")]
Reason = Annotated[str, typer.Option(help="Why; it is recorded.", callback=clean)]
_POLICY_HELP = "Decide by this file what asks for a policy, and run what it permits, until Ctrl-C."


def approve(
    workspace: Space,
    name: Name = "",
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask; the name stands for the bytes.")] = False,
    policy: Annotated[Path | None, typer.Option("--policy", help=_POLICY_HELP, dir_okay=False)] = None,
    once_idle: Annotated[bool, typer.Option(help="With --policy: end when nothing asks for it.")] = False,
    reason: Reason = "",
    memory: WhichMemory = None,
    trust_python: TrustPython = False,
) -> int:
    """Let a proposed goal run: shows it, asks, writes the approval, carries it out to its verdict."""
    place, clock = Workspace.open(workspace), SystemClock()
    proposals = Proposals(place.proposals)
    if not name and policy is None:
        print_result("\n".join(_list(proposals)) or "no proposal waits")
        return ExitCode.GOAL_MET
    admit_python(workspace, is_trusted=trust_python, announce=print_note)
    if policy is not None:
        return _approve_by_policy(place, proposals, policy, once_idle=once_idle)
    proposed = proposals.read(name)
    graph, decision = compile_proposed(place, proposed), proposals.find_decision(proposed)
    if decision is not None and decision.decision == "denied":
        raise DefinitionError.of("PROPOSAL_DECIDED", name, f"denied by {decision.by}: {decision.reason}")
    chosen = (f"  {node}: {graph.choices[node].skill} on {graph.choices[node].target}" for node in graph.order)
    print_note("\n".join((proposed.data.decode(), *chosen, f"sha256 {proposed.sha256}")))
    if not yes and not typer.confirm("Let it move the robot?", err=True):
        raise Exit(ExitCode.INTERRUPTED, "nothing was decided; `paos deny` records a refusal")
    if decision is None:
        proposals.decide(proposed, "approved", by=getpass.getuser(), at=clock.wall_iso(), reason=reason)
    report = carry_out(place, proposed, clock, memory=memory)
    print_result(f"goal {report.goal}: {report.verdict}  {report.reason}")
    return report.exit_code


def deny(workspace: Space, name: Annotated[str, typer.Argument(metavar="PROPOSAL")], reason: Reason = "") -> None:
    """Refuse a proposed goal; that is recorded, and who proposed it is told why."""
    proposals = Proposals(Workspace.open(workspace).proposals)
    proposals.decide(proposals.read(name), "denied", by=getpass.getuser(), at=SystemClock().wall_iso(), reason=reason)
    print_result(f"denied: {name}")


def _list(proposals: Proposals) -> list[str]:
    lines = []
    for name in proposals.list_waiting():
        try:
            proposal = proposals.read(name).proposal
            why = " ".join(proposal.reason.split())[:100]
            lines.append(f"{name}  asked by {proposal.by} at {proposal.at}, for a {proposal.decider}: {why}")
        except DefinitionError as error:
            lines.append(f"{name}  {error.problems[0]}")
    return lines


def _approve_by_policy(place: Workspace, proposals: Proposals, file: Path, *, once_idle: bool) -> int:
    policy, new = validate(ApprovalPolicy, read_yaml(file)), place.proposals / "new"
    by = f"{file.name} {hashlib.sha256(file.read_bytes()).hexdigest()}"
    new.mkdir(parents=True, exist_ok=True)
    print_note(f"decides by {file} until Ctrl-C; what asks for a person waits for `paos approve`")
    with Watch([new]) as watch:
        while True:
            for proposed in proposals.iter_readable():
                if proposed.proposal.decider == "policy":
                    code = _decide(place, proposals, proposed, policy, by)
                    if code == ExitCode.INTERRUPTED:
                        return int(code)
            if once_idle:
                return ExitCode.GOAL_MET
            watch.wait(POLL_S)


def _decide(place: Workspace, proposals: Proposals, proposed: Proposed, policy: ApprovalPolicy, by: str) -> ExitCode:
    """Approve and carry out, or deny with the reasons."""
    clock = SystemClock()
    at = clock.wall_iso()
    approved = proposals.count_approvals(by, (datetime.fromisoformat(at) - timedelta(days=1)).isoformat()[:19])
    try:
        objections = list(iter_objections(policy, compile_proposed(place, proposed), at=at, approved=approved))
    except DefinitionError as error:
        objections = list(error.problems)
    reason = "; ".join(map(str, objections))
    proposals.decide(proposed, "denied" if objections else "approved", by=by, at=at, reason=reason)
    if objections:
        print_result(f"denied: {proposed.name}  {reason}")
        return ExitCode.REJECTED
    report = carry_out(place, proposed, clock, restrict=partial(restrict, policy))
    print_result(f"goal {report.goal}: {report.verdict}  {report.reason}")
    return ExitCode(report.exit_code)
