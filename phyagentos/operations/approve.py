"""Decisions on proposed goals, and the run that an approval permits: nothing else starts one.

The bytes of a proposal become the goal, on the ordinary path of `paos agent`; nothing is read from its file again.
"""

import contextlib
import hashlib
import signal
from collections.abc import Callable, Iterator
from datetime import datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Literal

import msgspec
import yaml

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.graph import GoalGraph, read_goal_graph
from phyagentos.agent.mission.report import CANCELLED, MissionReport
from phyagentos.agent.tools.proposals import ApprovalPolicy, Proposals, Proposed, iter_objections, restrict
from phyagentos.assembly.agent_plane import run_agent
from phyagentos.assembly.paths import serve_alone
from phyagentos.assembly.planes import start_watch
from phyagentos.clock import Clock, SystemClock
from phyagentos.errors import DefinitionError, relocate
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import iter_nested, read_yaml, validate
from phyagentos.protocol.workspace.process_lock import RUNTIME_LOCK, is_held
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.scratch import open_scratch
from phyagentos.store.watch import POLL_S, Watch

_DAY = timedelta(days=1)


class WaitingProposal(msgspec.Struct, frozen=True, kw_only=True):
    """A proposal that waits for a decision; one that cannot be read has only its name and the `problem`."""

    name: str
    by: str = ""
    at: str = ""
    decider: str = ""
    reason: str = ""
    problem: str = ""


class ProposedGoal(msgspec.Struct, frozen=True, kw_only=True):
    """A proposal as it stands on the disk.

    Attributes:
        text: Its own bytes, whose hash is `sha256`.
        sessions: Node -> the skill and the target that would carry it out.
        decision: `approved`, or empty while it waits.
    """

    name: str
    text: str
    sha256: str
    sessions: dict[str, tuple[str, str]]
    decision: str = ""


class Decided(msgspec.Struct, frozen=True, kw_only=True):
    """A decision on a proposal, why, and of an approved one how its goal ended."""

    proposal: str
    decision: Literal["approved", "denied"]
    reason: str = ""
    report: MissionReport | None = None


def list_proposals(root: Path) -> tuple[WaitingProposal, ...]:
    """What waits for a decision in a workspace, the oldest first."""
    proposals = Proposals(Workspace.open(root).proposals)
    return tuple(_describe(proposals, name) for name in proposals.list_waiting())


def read_proposal(root: Path, name: str) -> ProposedGoal:
    """A proposal that may be approved, compiled as it would run.

    Raises DefinitionError `UNKNOWN_NAME`, `CHANGED`; `ALREADY_OVER` where it is denied; every problem of its graph.
    """
    place = Workspace.open(root)
    proposals = Proposals(place.proposals)
    proposed = proposals.read(name)
    graph, decision = _compile(place, proposed), proposals.find_decision(proposed)
    if decision is not None and decision.decision == "denied":
        raise DefinitionError.of("ALREADY_OVER", name, f"denied by {decision.by}: {decision.reason}")
    chosen = {node: (graph.choices[node].skill, graph.choices[node].target) for node in graph.order}
    known, text = decision.decision if decision is not None else "", proposed.data.decode()
    return ProposedGoal(name=name, text=text, sha256=proposed.sha256, sessions=chosen, decision=known)


def approve(root: Path, name: str, sha256: str, *, by: str, reason: str = "", memory: str | None = None) -> Decided:
    """Approve the proposal of these bytes, unless it is, and pursue its goal to the verdict.

    A runtime of its own carries it out where none serves the workspace. A goal that has its verdict is only reported.
    `memory` is as asked of `choose_memory`. The Python of the workspace's skills is run: see `admit_python` before.

    Raises DefinitionError as `read_proposal` does; `CHANGED` for other bytes.
    """
    proposed = record_approval(root, name, sha256, by=by, reason=reason)
    report = _carry_out(Workspace.open(root), proposed, SystemClock(), memory=memory)
    return Decided(proposal=name, decision="approved", reason=reason, report=report)


def record_approval(root: Path, name: str, sha256: str, *, by: str, reason: str = "") -> Proposed:
    """Write the approval of the proposal of these bytes, unless it is approved, and start nothing; the proposal.

    Raises DefinitionError as `approve` does.
    """
    shown, proposals = read_proposal(root, name), Proposals(Workspace.open(root).proposals)
    proposed = proposals.read(name)
    if proposed.sha256 != sha256:
        raise DefinitionError.of("CHANGED", name, f"bytes with the SHA-256 {proposed.sha256}", sha256)
    if not shown.decision:
        proposals.decide(proposed, "approved", by=by, at=SystemClock().wall_iso(), reason=reason)
    return proposed


def deny(root: Path, name: str, *, by: str, reason: str = "") -> Decided:
    """Refuse a proposal; raises DefinitionError `UNKNOWN_NAME`, `CHANGED`, `ALREADY_OVER`."""
    proposals = Proposals(Workspace.open(root).proposals)
    proposals.decide(proposals.read(name), "denied", by=by, at=SystemClock().wall_iso(), reason=reason)
    return Decided(proposal=name, decision="denied", reason=reason)


def follow_policy(
    root: Path, policy: Path, on_decided: Callable[[Decided], object], *, once_idle: bool = False
) -> tuple[Decided, ...]:
    """Decide by a policy file on what asks for one, and carry out what it permits, Python included.

    Goes on until a goal is cancelled or, `once_idle`, nothing asks for it. What asks for a person waits.
    """
    place, rules = Workspace.open(root), validate(ApprovalPolicy, read_yaml(policy))
    proposals, new = Proposals(place.proposals), place.proposals / "new"
    by = f"{policy.name} {hashlib.sha256(policy.read_bytes()).hexdigest()}"
    new.mkdir(parents=True, exist_ok=True)
    done: list[Decided] = []
    with Watch([new]) as watch:
        while True:
            for proposed in proposals.iter_readable():
                if proposed.proposal.decider == "policy":
                    done.append(_decide(place, proposals, proposed, rules, by))
                    on_decided(done[-1])
                    if (report := done[-1].report) is not None and report.verdict == CANCELLED:
                        return tuple(done)
            if once_idle:
                return tuple(done)
            watch.wait(POLL_S)


def _describe(proposals: Proposals, name: str) -> WaitingProposal:
    try:
        found = proposals.read(name).proposal
    except DefinitionError as error:
        return WaitingProposal(name=name, problem=str(error.problems[0]))
    return WaitingProposal(name=name, by=found.by, at=found.at, decider=found.decider, reason=found.reason)


def _compile(workspace: Workspace, proposed: Proposed) -> GoalGraph:
    """Its goal graph; raises `CHANGED` when another file says what would run."""
    found = {each.get("include") for each in iter_nested(proposed.proposal.graph) if isinstance(each, dict)}
    if names := sorted(each for each in found if isinstance(each, str)):
        expected = "included graphs in their places"
        raise DefinitionError.of("CHANGED", proposed.name, f"include: {', '.join(names)}", expected)
    with as_file(_render(proposed.proposal.graph)) as file:
        return read_goal_graph(file, Catalogue.of_workspace(workspace))


def _decide(place: Workspace, proposals: Proposals, proposed: Proposed, rules: ApprovalPolicy, by: str) -> Decided:
    """Approve and carry out, or deny with the reasons."""
    clock = SystemClock()
    at = clock.wall_iso()
    approved = proposals.count_approvals(by, (datetime.fromisoformat(at) - _DAY).isoformat()[:19])
    try:
        objections = list(iter_objections(rules, _compile(place, proposed), at=at, approved=approved))
    except DefinitionError as error:
        objections = list(error.problems)
    decision: Literal["approved", "denied"] = "denied" if objections else "approved"
    reason = "; ".join(map(str, objections))
    proposals.decide(proposed, decision, by=by, at=at, reason=reason)
    report = None if objections else _carry_out(place, proposed, clock, restrict=partial(restrict, rules))
    return Decided(proposal=proposed.name, decision=decision, reason=reason, report=report)


def _carry_out(
    workspace: Workspace,
    proposed: Proposed,
    clock: Clock,
    *,
    memory: str | None = None,
    restrict: Callable[[Catalogue], Catalogue] | None = None,
) -> MissionReport:
    """Pursue an approved proposal to its verdict; `restrict` narrows what it may use, repairs included.

    Raises DefinitionError `NOT_PERMITTED` without an approval of exactly these bytes.
    """
    decision = Proposals(workspace.proposals).find_decision(proposed)
    if decision is None or decision.decision != "approved":
        found = "no decision" if decision is None else f"denied by {decision.by}: {decision.reason}"
        raise DefinitionError.of("NOT_PERMITTED", proposed.name, found, "an approval of these bytes")
    _compile(workspace, proposed)
    with contextlib.ExitStack() as stack:
        alive = None
        for number in (signal.SIGINT, signal.SIGTERM):  # the agent's own until the goal is over
            stack.callback(signal.signal, number, signal.getsignal(number))
        if not is_held(workspace.root / RUNTIME_LOCK):
            stack.enter_context(serve_alone(workspace, clock))
            alive = stack.enter_context(start_watch(workspace).running(clock)).is_alive
        file, seed = stack.enter_context(as_file(_render(proposed.proposal.graph))), proposed.proposal.seed
        goal, root = proposed.name, workspace.root
        return run_agent(root, file, seed, goal=goal, memory=memory, restrict=restrict, is_runtime_alive=alive)


@contextlib.contextmanager
def as_file(text: str) -> Iterator[Path]:
    """A goal graph as a file that only this user can read; problems in it stand under the file's name alone."""
    with open_scratch() as folder:
        file = folder / "goal_graph.yaml"
        file.write_text(text, encoding="utf-8")
        try:
            yield file
        except DefinitionError as error:
            raise DefinitionError(relocate(error.problems, file.parent)) from error


def _render(graph: Fields) -> str:
    return yaml.safe_dump(graph, sort_keys=False, allow_unicode=True)
