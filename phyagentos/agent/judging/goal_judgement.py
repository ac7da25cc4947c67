"""The judgement of a whole goal, and the evidence of its sessions.

A goal is met when every node is done, and its acceptance and constraints are true in the latest snapshot, changes
measured against the first: what a session could not see of a constraint must be seen true in the end. Targets that the
goal puts into one world have one latest snapshot; every other target has a world of its own. Where the worlds of a goal
disagree, the truth is unknown.
"""

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from phyagentos.agent.goals.graph import GoalGraph
from phyagentos.agent.goals.selector import ANY
from phyagentos.agent.judging.judges.judge_registry import make_unknown
from phyagentos.agent.judging.judges.predicates import evaluate_on, judge_answer
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import read_text
from phyagentos.protocol.predicates.library import ArgumentKind
from phyagentos.protocol.predicates.predicate import View, find_question, has_metric, parse_predicate
from phyagentos.protocol.sessions.evidence import AFTER, Bundle, read_bundle
from phyagentos.protocol.sessions.lifecycle import FINAL_STATES
from phyagentos.protocol.sessions.session import Session, SessionStatus
from phyagentos.protocol.sessions.verdicts import Criterion, Verdict
from phyagentos.protocol.world.environment import ENVIRONMENT, Environment, read_environment
from phyagentos.protocol.world.truth import Truth
from phyagentos.wording import count_criteria

Age = tuple[int, str]


@dataclass(slots=True)
class Seen:
    """The world before the first and after the latest of some sessions, with their ages, and the file of the latter."""

    initial: Environment | None = None
    now: Environment | None = None
    now_file: str = AFTER
    oldest: Age = (sys.maxsize, "")
    latest: Age = (-1, "")

    def take_in(self, age: Age, bundle: Bundle) -> None:
        """Include the snapshots of one more session."""
        if bundle.before is not None and age < self.oldest:
            self.oldest, self.initial = age, bundle.before
        if bundle.after is not None and age > self.latest:
            self.latest, self.now = age, bundle.after
            self.now_file = f"{bundle.execution.evidence}/{AFTER}"


class Evidence:
    """The bundles of one goal, and the first and the latest snapshot in those that were read.

    Sessions are judged in the order of their end, so that order is also the age of their snapshots. The time of the
    world is not: it begins anew when a simulated world was lost.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self._ages: dict[str, Age] = {}
        self.all = Seen()
        self.by_target: dict[str, Seen] = {}

    def read(self, status: SessionStatus, *, with_course: bool = True) -> Bundle:
        """The bundle of an executed session, empty where unreadable; `with_course` includes trace and events."""
        bundle = self._read(status, with_course)
        # verdicts of an earlier agent come first, in their order; then those of this one
        own = (0, status.updated_at) if status.state in FINAL_STATES else (len(self._ages) + 1, "")
        age = self._ages.setdefault(bundle.session.id, own)
        for seen in (self.all, self.by_target.setdefault(bundle.session.target, Seen())):
            seen.take_in(age, bundle)
        return bundle

    def take_in(self, status: SessionStatus) -> None:
        """Include the snapshots of a session, without reading them again."""
        if status.contract.id not in self._ages:
            self.read(status, with_course=False)

    def find_latest(self, episode: str) -> Environment | None:
        """The latest snapshot that was judged; before the first, what ENVIRONMENT.md shows of this episode."""
        if self.all.now is not None:
            return self.all.now
        try:
            shown = read_environment(read_text(self.root / ENVIRONMENT.file))
        except DefinitionError:
            return None
        return shown if shown.episode == episode else None

    def _read(self, status: SessionStatus, with_course: bool) -> Bundle:
        session, execution = status.contract, status.execution
        if execution is None:
            raise ExecutionError("NOT_EXECUTED", f"session {session.id} is {status.state} and was never executed")
        folder = self.root / execution.evidence
        try:
            return read_bundle(folder, session, execution, with_course=with_course)
        except ExecutionError as error:
            execution = msgspec.structs.replace(execution, message=f"{execution.message} {error}".strip())
            nothing: Fields = {"before": None, "after": None, "holds": (), "trace": (), "events": ()}
            return Bundle(folder=folder, session=session, execution=execution, **nothing)


def carry_conditions(
    session: Session, now: Environment | None, lineage: Iterable[SessionStatus], evidence: Evidence
) -> tuple[Criterion, ...]:
    """Hold conditions that earlier sessions of its node could not see, judged against the worlds before those.

    As of a goal's constraints: what was not seen all through must be seen true in the end.
    """
    if now is None:
        return ()
    begun = {
        text: evidence.read(status, with_course=False).before
        for text, status in find_unseen_holds(session, lineage).items()
    }
    return tuple(
        evaluate_on(text, "constraint", session.make_view(now, before), AFTER)
        for text, before in begun.items()
        if before is not None
    )


def find_unseen_holds(session: Session, lineage: Iterable[SessionStatus]) -> dict[str, SessionStatus]:
    """Hold conditions on the world that an earlier session of the node left unknown -> the first that did."""
    found: dict[str, SessionStatus] = {}
    for status in sorted(lineage, key=lambda each: each.contract.attempt):
        if status.contract.attempt >= session.attempt:
            break
        criteria = status.decision.criteria if status.decision is not None and not status.contract.purpose else ()
        for each in criteria:
            if each.kind == "hold" and each.truth is Truth.UNKNOWN and not has_metric(each.text):
                found.setdefault(each.text, status)
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """The verdict of a goal, by its own acceptance and its constraints but those on metrics, in the latest snapshot."""

    verdict: Verdict
    reason: str
    criteria: tuple[Criterion, ...] = ()
    now: Environment | None = None


def judge_goal(
    graph: GoalGraph, evidence: Evidence, blocked: Mapping[str, str], answers: Path | None = None
) -> Outcome:
    """Judge whether the goal is met; `blocked` maps each blocked node to its reason, people answered in `answers`."""
    kinds = {text: "constraint" for text in graph.spec.constraints if not has_metric(text)}
    kinds |= dict.fromkeys(graph.spec.accept, "accept")
    criteria = tuple(
        judge_answer(question, kind, answers or evidence.root)
        if (question := find_question(text))
        else _judge(text, kind, graph, evidence)
        for text, kind in kinds.items()
    )
    missed = [criterion for criterion in criteria if criterion.truth is not Truth.TRUE]
    if blocked:
        node, why = next(iter(blocked.items()))
        verdict, reason = Verdict.FAILURE, f"node {node} cannot be done: {why}"
    elif missed:
        verdict, reason = Verdict.FAILURE, f"{missed[0].text} is {missed[0].truth}: {missed[0].because}"
    else:
        verdict = Verdict.SUCCESS
        is_whole = not graph.rescuers and not any(node.is_conditional for node in graph.nodes.values())
        nodes = "every node" if is_whole else "every node on a branch that was taken"
        reason = f"{nodes} is done, and {count_criteria(len(criteria), len(criteria))}"
    return Outcome(verdict=verdict, reason=reason, criteria=criteria, now=evidence.all.now)


def _join(seen: Sequence[Seen]) -> Seen:
    first, last = min(seen, key=lambda each: each.oldest), max(seen, key=lambda each: each.latest)
    return Seen(initial=first.initial, now=last.now, now_file=last.now_file, oldest=first.oldest, latest=last.latest)


def _judge(text: str, kind: str, graph: GoalGraph, evidence: Evidence) -> Criterion:
    """One criterion, in the world of the target that it names, else in those of all."""
    roles = {role: target for role, target in graph.spec.targets.items() if target != ANY}
    predicate = parse_predicate(text).rename_targets(roles)
    worlds = {target: seen for target, seen in evidence.by_target.items() if seen.now is not None}
    named = {reference.name for reference in predicate.iter_references() if reference.kind is ArgumentKind.TARGET}
    if named & worlds.keys():
        worlds = {target: worlds[target] for target in named & worlds.keys()}
    else:
        for names in graph.spec.worlds.values():
            together = [worlds.pop(target) for name in names if (target := roles.get(name, name)) in worlds]
            if together:
                worlds[" and ".join(names)] = _join(together)
    targets = {choice.target for choice in graph.choices.values()}
    only = targets.pop() if len(targets) == 1 else None
    answers = {}
    for target, seen in worlds.items():
        assert seen.now is not None  # by what was chosen above
        view = View(now=seen.now, initial=seen.initial, target=only, interchangeable=graph.spec.interchangeable)
        answers[target] = evaluate_on(predicate.text, kind, view, seen.now_file)
    truths = {criterion.truth for criterion in answers.values()}
    if len(truths) == 1:
        return answers[max(worlds, key=lambda target: worlds[target].latest)]
    told = (f"{criterion.truth} in the world of {target}" for target, criterion in sorted(answers.items()))
    return make_unknown(predicate.text, kind, "", ", ".join(told) or "no session left a snapshot")
