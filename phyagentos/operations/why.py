"""Why: a verdict explained from ledger and evidence, down to the layer, the leaf and the number that decided it.

Nothing is judged again: the diagnosis is the agent's own, over the same evidence.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec

from phyagentos.agent.judging.diagnosis import diagnose
from phyagentos.agent.judging.manipulation_timeline import find_failed_leaf
from phyagentos.assembly.planted_faults import find_unstruck
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.documents.markdown import format_value
from phyagentos.protocol.sessions.evidence import Bundle, read_bundle
from phyagentos.protocol.sessions.evidence_manifest import read_manifest
from phyagentos.protocol.sessions.session import Execution, GoalId, SessionId, SessionStatus
from phyagentos.protocol.sessions.tasks import GoalStatus, NodeState, NodeStatus
from phyagentos.protocol.sessions.verdicts import Attempt, Verdict
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.idealisations import format_idealisations
from phyagentos.store.ledger import Ledger
from phyagentos.store.subjects import find_node, get_goal, get_session

_OWN_WAY = "the skill's own way"


class Explanation(msgspec.Struct, frozen=True, kw_only=True):
    """What `paos why --json` prints: all that the journal says of a goal, node or session, and why it stands so."""

    found: GoalStatus | NodeStatus | SessionStatus
    explanation: tuple[str, ...]


def why(root: Path, subject: str = "") -> Explanation:
    """Explain the verdict on a goal, node or session of a workspace; of the latest goal without a name.

    Raises DefinitionError `UNKNOWN_SESSION`; ExecutionError `JOURNAL_DAMAGED`, `EVIDENCE_UNREADABLE`.
    """
    return explain_subject(Workspace.open(root), read_ledger(root, subject), subject)


def explain_subject(workspace: Workspace, ledger: Ledger, subject: str = "") -> Explanation:
    """The same, as a ledger says."""
    latest = dict(list(ledger.goals.items())[-1:])
    goal = ledger.goals.get(GoalId(subject)) if subject else get_goal("", str(workspace.root), latest)
    holder, name = find_node(subject, ledger.goals)
    found: GoalStatus | NodeStatus | SessionStatus
    if goal is not None:
        found, text = goal, explain_goal(workspace, ledger, goal)
    elif holder is not None and not holder.nodes[name].sessions:
        found, text = holder.nodes[name], explain_node(workspace, ledger, holder, name)
    else:
        id = get_session(subject, ledger.sessions)
        found, text = ledger.sessions[id], explain_session(workspace, ledger, id)
    return Explanation(found=found, explanation=tuple(text.splitlines()))


def explain_session(workspace: Workspace, ledger: Ledger, id: SessionId) -> str:
    """Everything that is known about the end of one session, one fact a line."""
    status = ledger.sessions[id]
    lines = [f"{id}: {status.state}", f"  objective   {status.contract.objective}"]
    if status.contract.parent is not None:
        lines.append(f"  parent      {status.contract.parent}, strategy {status.contract.strategy or _OWN_WAY}")
    lines += [f"  advised     {sentence}" for sentence in status.contract.advice]
    lines += _explain_execution(status)
    if status.execution is not None:
        bundle = read_bundle(workspace.root / status.execution.evidence, status.contract, status.execution)
        own, others = status.contract, ledger.sessions.values()
        node = (each for each in others if (each.contract.goal, each.contract.node) == (own.goal, own.node))
        prior = tuple(each for each in node if each.contract.attempt < own.attempt)
        bundle = msgspec.structs.replace(bundle, prior=prior)
        for attempt in status.attempts:
            lines += _explain_attempt(attempt, bundle)
        lines.append(f"  evidence    {bundle.folder}")
        lines += _explain_thinning(bundle)
    lines += [f"  fault       {fault} never struck in this run" for fault in find_unstruck(workspace.root)]
    lines += [
        f"  child       {child.contract.id}, strategy {child.contract.strategy or _OWN_WAY}"
        for child in ledger.sessions.values()
        if child.contract.parent == id
    ]
    return "\n".join(lines)


def explain_goal(workspace: Workspace, ledger: Ledger, goal: GoalStatus) -> str:
    """Why a goal stands where it does: its verdict, its nodes, and the first cause of a miss."""
    lines = [f"{goal.id}: {goal.verdict or 'no verdict yet'}", f"  objective   {goal.objective}"]
    lines += [f"  because     {goal.reason}"] if goal.reason else []
    lines += [f"    {each.truth.mark} {each.text}: {each.because or _show(each.measured)}" for each in goal.criteria]
    lines += [f"  node        {name}: {node.state}" for name, node in goal.nodes.items()]
    bad = next((name for name, node in goal.nodes.items() if node.state is NodeState.BLOCKED), None)
    return "\n".join([*lines, *([explain_node(workspace, ledger, goal, bad)] if bad is not None else [])])


def explain_node(workspace: Workspace, ledger: Ledger, goal: GoalStatus, name: str) -> str:
    """Why a node stands where it does: along the nodes that it waits for, to the session where it began."""
    node = goal.nodes[name]
    before = {each: goal.nodes[each] for each in node.after if each in goal.nodes}
    lines = [f"{goal.id}.{name}: {node.state} {node.reason}".rstrip()]
    lines += [f"  waits for   {each}: {found.state}" for each, found in before.items()]
    if node.sessions:
        return "\n".join([*lines, explain_session(workspace, ledger, node.sessions[-1])])
    held = next((each for each, found in before.items() if found.state is not NodeState.DONE), None)
    return "\n".join([*lines, *([explain_node(workspace, ledger, goal, held)] if held is not None else [])])


def _explain_execution(status: SessionStatus) -> Iterator[str]:
    execution: Execution | None = status.execution
    if execution is None:
        yield f"  execution   none: {status.reason or 'it has not run'}"
        return
    code = f" {execution.code}" if execution.code else ""
    yield (
        f"  execution   {execution.ended.value}{code}: {execution.sim_time_s:.2f} s simulated, "
        f"{execution.ticks} commands, {execution.interventions} safety interventions"
    )
    if execution.message:
        yield f"              {execution.message}"
    if execution.driver:
        yield f"  moved by    driver {execution.driver}"


def _explain_attempt(attempt: Attempt, bundle: Bundle) -> Iterator[str]:
    kind = "review " if attempt.is_review else "verdict"
    by = f"by {attempt.verifier}, mode {attempt.mode.value}"
    yield f"  {kind}     {attempt.verdict.value}, sensing {attempt.sensing}, {by}"
    if attempt.idealisations:
        yield f"  idealised   {format_idealisations(attempt.idealisations)}"
    for criterion in attempt.criteria:
        because = criterion.because or _show(criterion.measured)
        at = f" at {criterion.at_s:.2f} s" if criterion.at_s is not None else ""
        source = f" ({criterion.evidence}{at})" if criterion.evidence else ""
        yield f"    {criterion.truth.mark} {criterion.kind} {criterion.text}: {because}{source}"
    if attempt.verdict is Verdict.SUCCESS:
        return
    diagnosis = diagnose(bundle, attempt.criteria)
    if diagnosis.repeats:
        yield f"  repeated    {diagnosis.cause}, {diagnosis.repeats + 1} times in a row"
    yield f"  layer       {diagnosis.cause.layer.value}"
    yield f"  cause       {attempt.cause}: {diagnosis.fact or attempt.reason}"
    event = find_failed_leaf(bundle)
    if event is not None:
        yield f"  leaf        {event.path} at {event.time_s:.2f} s: {event.code} {event.message}".rstrip()
        if event.numbers:
            yield f"  numbers     {_show(event.numbers)}"


def _explain_thinning(bundle: Bundle) -> Iterator[str]:
    manifest = read_manifest(bundle.folder)
    for thinning in manifest.thinned if manifest is not None else ():
        yield f"  thinned     {thinning.at}: {', '.join(thinning.files)} ({thinning.rule})"


def _show(values: Mapping[str, Any]) -> str:
    """`a 1.5, b [1, 2]`, numbers short."""
    return ", ".join(f"{name} {_show_value(value)}" for name, value in values.items()) or "none"


def _show_value(value: Any) -> str:
    if isinstance(value, Mapping):
        return f"({_show(value)})"
    if isinstance(value, list | tuple):
        return f"[{', '.join(_show_value(item) for item in value)}]"
    return format_value(value)
