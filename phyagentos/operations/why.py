"""Why: a verdict explained from ledger and evidence, down to the layer, the leaf and the number that decided it.

Nothing is judged again: the diagnosis is the agent's own, over the same evidence.
"""

from collections.abc import Iterable, Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any

import msgspec

from phyagentos.agent.judging.diagnosis import diagnose
from phyagentos.agent.judging.judges.predicates import judge_answer
from phyagentos.agent.judging.manipulation_timeline import find_failed_leaf
from phyagentos.assembly.planted_faults import find_unstruck
from phyagentos.operations.answer import OpenQuestion, iter_open
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.documents.markdown import format_value
from phyagentos.protocol.predicates.predicate import find_question
from phyagentos.protocol.sessions.evidence import Bundle, count_solver_calls, read_bundle
from phyagentos.protocol.sessions.evidence_manifest import read_manifest
from phyagentos.protocol.sessions.session import Execution, GoalId, Session, SessionStatus
from phyagentos.protocol.sessions.tasks import GoalStatus, NodeState, NodeStatus
from phyagentos.protocol.sessions.verdicts import PERSON, Attempt, Criterion, Verdict
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.idealisations import format_idealisations
from phyagentos.protocol.world.truth import Truth
from phyagentos.store.ledger import Ledger
from phyagentos.store.subjects import find_node, get_goal, get_session
from phyagentos.wording import count

Fact = tuple[str, str]  # what a line is about, and its text


class Explanation(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What `paos why --json` prints: all that the journal says of a goal, node or session, and why it stands so."""

    explanation: tuple[str, ...]
    goal: GoalStatus | None = None
    node: NodeStatus | None = None
    session: SessionStatus | None = None


def why(root: Path, subject: str = "") -> Explanation:
    """Explain the verdict on a goal, node or session of a workspace; of the latest goal without a name.

    Raises DefinitionError `UNKNOWN_NAME`; ExecutionError `JOURNAL_DAMAGED`, `EVIDENCE_DAMAGED`.
    """
    return explain_subject(Workspace.open(root), read_ledger(root, subject), subject)


def explain_subject(workspace: Workspace, ledger: Ledger, subject: str = "") -> Explanation:
    """The same, as a ledger says."""
    latest = dict(list(ledger.goals.items())[-1:])
    goal = ledger.goals.get(GoalId(subject)) if subject else get_goal("", str(workspace.root), latest)
    if goal is not None:
        return Explanation(goal=goal, explanation=(*_explain_goal(workspace, ledger, goal),))
    holder, name = find_node(subject, ledger.goals)
    if holder is not None and not holder.nodes[name].sessions:
        lines = _explain_node(workspace, ledger, holder, name)
        return Explanation(node=holder.nodes[name], explanation=(*lines,))
    status = ledger.sessions[get_session(subject, ledger.sessions)]
    return Explanation(session=status, explanation=(*_explain_session(workspace, ledger, status),))


def _explain_goal(workspace: Workspace, ledger: Ledger, goal: GoalStatus) -> Iterator[str]:
    """Its verdict, its nodes, and the first cause of a miss."""
    criteria = ((f"  {each.truth.mark} {each.text}: ", _render_reason(each)) for each in goal.criteria)
    nodes = (("node", f"{name}: {node.state}") for name, node in goal.nodes.items())
    yield f"{goal.id}: {goal.verdict or 'no verdict yet'}"
    unknown = filter(None, (find_question(each.text) for each in goal.criteria if each.truth is Truth.UNKNOWN))
    since = [judge_answer(question, "accept", workspace.answers_of(goal.id)) for question in unknown]
    answered = (("answered", f"{each.text}: {each.because}") for each in since if each.evidence)
    questions = map(_show_question, iter_open(workspace, ledger, goal.id))
    yield from _render(
        [("objective", goal.objective), ("because", goal.reason), *criteria, *answered, *nodes, *questions]
    )
    for bad in [name for name, node in goal.nodes.items() if node.state is NodeState.BLOCKED][:1]:
        yield from _explain_node(workspace, ledger, goal, bad)


def _explain_node(workspace: Workspace, ledger: Ledger, goal: GoalStatus, name: str) -> Iterator[str]:
    """Along the nodes that it waits for, to the session where it began."""
    node = goal.nodes[name]
    before = {each: goal.nodes[each] for each in node.after if each in goal.nodes}
    yield f"{goal.id}.{name}: {node.state} {node.reason}".rstrip()
    yield from _render(("waits for", f"{each}: {found.state}") for each, found in before.items())
    if node.sessions:
        yield from _explain_session(workspace, ledger, ledger.sessions[node.sessions[-1]])
        return
    for held in [each for each, found in before.items() if found.state is not NodeState.DONE][:1]:
        yield from _explain_node(workspace, ledger, goal, held)


def _explain_session(workspace: Workspace, ledger: Ledger, status: SessionStatus) -> Iterator[str]:
    """Everything that is known about the end of one session, one fact a line."""
    own, others = status.contract, ledger.sessions.values()
    facts = [("objective", own.objective)]
    if own.parent is not None:
        facts.append(("parent", f"{own.parent}, {_describe_strategy(own)}"))
    facts += [("advised", sentence) for sentence in own.advice]
    if (execution := status.execution) is None:
        facts.append(("execution", f"none: {status.reason or 'it has not run'}"))
    else:
        facts += _iter_execution(execution)
        node = (each for each in others if (each.contract.goal, each.contract.node) == (own.goal, own.node))
        prior = tuple(each for each in node if each.contract.attempt < own.attempt)
        bundle = read_bundle(workspace.root / execution.evidence, own, execution)
        bundle = msgspec.structs.replace(bundle, prior=prior)
        facts += chain.from_iterable(_iter_attempt(attempt, bundle) for attempt in status.attempts)
        calls = ", ".join(f"{solver} {count}" for solver, count in sorted(count_solver_calls(bundle.events).items()))
        facts.append(("planned by", calls and f"{calls} calls"))
        manifest = read_manifest(bundle.folder)
        thinned = manifest.thinned if manifest is not None else ()
        facts.append(("evidence", str(bundle.folder)))
        facts += [("thinned", f"{each.at}: {', '.join(each.files)} ({each.rule})") for each in thinned]
    facts += [_show_question(each) for each in iter_open(workspace, ledger, own.goal) if each.subject == own.id]
    facts += [("fault", f"{fault} never struck in this run") for fault in find_unstruck(workspace.root)]
    children = [each.contract for each in others if each.contract.parent == own.id]
    facts += [("child", f"{each.id}, {_describe_strategy(each)}") for each in children]
    return iter([f"{own.id}: {status.state}", *_render(facts)])


def _show_question(each: OpenQuestion) -> Fact:
    return "question", f"{each.question} `paos answer {each.subject} yes|no`"


def _describe_strategy(session: Session) -> str:
    return f"{session.skill} {session.strategy}" if session.strategy else f"{session.skill} as before"


def _iter_execution(execution: Execution) -> Iterator[Fact]:
    yield (
        "execution",
        (
            f"{f'{execution.ended.value} {execution.code}'.strip()}: {execution.sim_time_s:.2f} s simulated, "
            f"{count(execution.ticks, 'command')}, {count(execution.interventions, 'safety intervention')}"
        ),
    )
    yield "", execution.message
    yield "moved by", execution.driver and f"driver {execution.driver}"
    yield "taken over", execution.led_by and f"by {execution.led_by}"


def _iter_attempt(attempt: Attempt, bundle: Bundle) -> Iterator[Fact]:
    if attempt.verifier == PERSON:
        yield "contested", f"{attempt.verdict.value}, by {attempt.reason}"
        return
    by = f"by {attempt.verifier}, mode {attempt.mode.value}"
    yield ("review" if attempt.is_review else "verdict"), f"{attempt.verdict.value}, sensing {attempt.sensing}, {by}"
    yield "idealised", format_idealisations(attempt.idealisations) if attempt.idealisations else ""
    yield "cameras", bundle.after.describe_cameras() if bundle.after is not None else ""
    for criterion in attempt.criteria:
        at = f" at {criterion.at_s:.2f} s" if criterion.at_s is not None else ""
        source = f" ({criterion.evidence}{at})" if criterion.evidence else ""
        head = f"  {criterion.truth.mark} {criterion.kind} {criterion.text}: "
        yield head, f"{_render_reason(criterion)}{source}"
    if attempt.verdict is Verdict.SUCCESS:
        return
    diagnosis = diagnose(bundle, attempt.criteria)
    yield "repeated", f"{diagnosis.cause}, {diagnosis.repeats + 1} times in a row" if diagnosis.repeats else ""
    yield "layer", diagnosis.cause.layer.value
    yield "cause", f"{attempt.cause}: {diagnosis.fact or attempt.reason}"
    if (event := find_failed_leaf(bundle)) is not None:
        yield "leaf", f"{event.path} at {event.time_s:.2f} s: {event.code} {event.message}"
        yield "numbers", _show(event.numbers) if event.numbers else ""


def _render(facts: Iterable[Fact]) -> Iterator[str]:
    """A line of each fact that there is."""
    return (f"  {label:<12}{text}".rstrip() for label, text in facts if text)


def _render_reason(criterion: Criterion) -> str:
    return criterion.because or _show(criterion.measured) or "none"


def _show(value: Any) -> str:
    """`a 1.5, b [1, 2]`, numbers short."""
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_show_inside(each)}" for name, each in value.items())
    return f"[{', '.join(map(_show_inside, value))}]" if isinstance(value, list | tuple) else format_value(value)


def _show_inside(value: Any) -> str:
    return f"({_show(value)})" if isinstance(value, Mapping) else _show(value)
