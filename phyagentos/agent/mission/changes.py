"""Changes of a goal's graph while it is pursued: asked for by a person, decided on what is seen, or planned anew.

A change is one record with the difference, and a file in `goals/` with the whole graph, which is read from then on.
What is planned anew, where no repair of a node is left, are nodes that run on its failure, so that they make up for it;
what waited for it is left out.
"""

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from phyagentos.agent.goals.amendment import (
    compute_difference,
    find_contradictions,
    find_fitting,
    find_graph,
    keep_graph,
    set_values,
)
from phyagentos.agent.goals.graph import GoalGraph, read_goal_graph
from phyagentos.agent.goals.selector import ANY
from phyagentos.agent.goals.spec import WantedGoal
from phyagentos.agent.judging.goal_judgement import Evidence, Seen
from phyagentos.agent.judging.judges.predicates import evaluate_on
from phyagentos.agent.mission.drafting import Drafter, join
from phyagentos.agent.mission.goal_facts import GoalFacts
from phyagentos.agent.mission.task_document import TaskEdit
from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import read_yaml
from phyagentos.protocol.predicates.predicate import View, iter_entities, parse_predicate, substitute
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.sessions.tasks import NodeState
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.truth import Truth
from phyagentos.store.admission import Entry, GoalEvent

if TYPE_CHECKING:
    from phyagentos.agent.planning.answers import PlannedGoal

PLANS_MAX = 2  # of one goal
_OPEN = frozenset({NodeState.WAITING, NodeState.READY, NodeState.INVALIDATED})


@dataclass(frozen=True, slots=True, kw_only=True)
class Changes:
    """Decides on changes of one goal's graph."""

    facts: GoalFacts
    drafter: Drafter
    evidence: Evidence

    def answer(self, file: str) -> list[Entry]:
        """The graph in `goals/` that a person wants, taken over or refused."""
        try:
            wanted = read_goal_graph(self._workspace.goals / file, self.drafter.compiler.catalogue)
            problems = [*find_contradictions(self.facts.graph, wanted, self.facts.ledger.goals[self.facts.goal])]
        except DefinitionError as error:
            problems = list(error.problems)
        if problems:
            why = f"refused: {join(map(str, problems))}"
            return [self.facts.note(GoalEvent.AMENDMENT_REFUSED, {"file": file, "reason": why})]
        return [self._amend(wanted, file, "as a person asked for")]

    def ask(self, edit: TaskEdit) -> list[Entry]:
        """An edit of TASK.md as a graph that a person wants; `answer` follows."""
        authored = self._read_authored()
        sessions = {name: dict(node) for name, node in authored["sessions"].items() if name not in edit.removed}
        foreign = [*edit.foreign, *({*edit.removed, *edit.after} - authored["sessions"].keys())]
        if foreign:
            why = f"TASK.md: {', '.join(foreign)} cannot be changed there; write the graph, and use `paos amend`"
            return [self.facts.note(GoalEvent.AMENDMENT_REFUSED, {"reason": f"refused: {why}"})]
        for name, node in sessions.items():
            edges = [each for each in node.get("after", ()) if isinstance(each, dict)]
            before = edit.after.get(name, [each for each in node.get("after", ()) if isinstance(each, str)])
            node["after"] = [*(each for each in before if each not in edit.removed), *edges]
        file = keep_graph(self._workspace, self.facts.goal, authored | edit.judged | {"sessions": sessions})
        return [self.facts.note(GoalEvent.AMENDMENT_ASKED, {"file": file.name})]

    def decide(
        self, name: str, look_for: Callable[[Sequence[Criterion], Environment], list[Entry]], *, is_quiet: bool
    ) -> list[Entry] | None:
        """What follows for a ready node whose condition is decided on what is seen; None where it becomes a session.

        Empty while its condition is unknown, and sessions live (not `is_quiet`) beside which none may look.
        """
        seen = self._find_seen(name)
        criteria = self._judge(name, seen)
        if false := next((each for each in criteria if each.truth is Truth.FALSE), None):
            return [self.drafter.note(name, GoalEvent.NODE_SKIPPED, f"{false.text} is false: {false.because}")]
        if unknown := [each for each in criteria if each.truth is Truth.UNKNOWN]:
            if not is_quiet:
                return []
            looks = look_for(unknown, seen.now) if seen.now is not None else []
            why = f"its condition is unknown: {unknown[0].text}: {unknown[0].because}"
            return looks or self.drafter.block(name, why)
        return self._fan_out(name, seen) if self.facts.graph.nodes[name].is_open else None

    def _fan_out(self, name: str, seen: Seen) -> list[Entry]:
        """The nodes that a fan-out becomes, or its end where nothing fits."""
        node = self.facts.graph.nodes[name]
        asked = "; ".join(text for text in node.spec.foreach.values() if isinstance(text, str))
        fitting = find_fitting(node, self._roles, self._view(name, seen)) if seen.now is not None else {}
        if not fitting or not all(fitting.values()):
            return [self.drafter.note(name, GoalEvent.NODE_SKIPPED, f"nothing is seen that fits {asked}")]
        file = keep_graph(self._workspace, self.facts.goal, set_values(self._read_authored(), node, fitting))
        try:
            graph = read_goal_graph(file, self.drafter.compiler.catalogue)
        except DefinitionError as error:
            return self.drafter.block(name, str(error))
        names = ", ".join(each for each in graph.nodes if each not in self.facts.graph.nodes)
        return [self._amend(graph, file.name, f"{name} becomes {names}: seen to fit {asked}")]

    def _judge(self, name: str, seen: Seen) -> list[Criterion]:
        node = self.facts.graph.nodes[name]
        filled = (parse_predicate(substitute(text, node.spec.arguments)) for text in node.spec.when)
        texts = [predicate.rename_targets(self._roles).text for predicate in filled]
        if seen.now is not None:
            return [evaluate_on(text, "accept", self._view(name, seen), seen.now_file) for text in texts]
        why = "nothing was seen"
        return [Criterion(text=each, kind="accept", truth=Truth.UNKNOWN, because=why) for each in texts]

    def _view(self, name: str, seen: Seen) -> View:
        assert seen.now is not None  # the caller has looked
        target = self.facts.graph.choices[name].target
        agreed = self.facts.graph.spec.interchangeable
        return View(now=seen.now, initial=seen.initial, target=target, interchangeable=agreed)

    def _find_seen(self, name: str) -> Seen:
        """The first and the latest snapshot on the node's target; without one there, those of all."""
        self.drafter.take_in_ended()
        own = self.evidence.by_target.get(self.facts.graph.choices[name].target)
        return own if own is not None and own.now is not None else self.evidence.all

    @property
    def _roles(self) -> Mapping[str, str]:
        return {role: target for role, target in self.facts.graph.spec.targets.items() if target != ANY}

    def find_unmet(self, session: Session, world: Environment) -> tuple[str, ...]:
        """What a session needs of the world and lacks now, so that no other way of carrying it out can help."""
        from phyagentos.agent.planning.domain import build_domain
        from phyagentos.agent.planning.recipe_domain import build_recipe_domain, is_of_amounts

        accept = tuple(text for text in session.accept if parse_predicate(text).is_lasting)
        if not accept:
            return ()
        wanted, catalogue = self._want(accept), self.drafter.compiler.catalogue
        try:
            domain = (build_recipe_domain if is_of_amounts(wanted) else build_domain)(wanted, catalogue, world)
        except DefinitionError:  # of a form that no plan is made for
            return ()
        return domain.find_unmet((session.skill, session.target, session.parameters))

    def find_movers(self, node: str, objects: Collection[str]) -> dict[str, str]:
        """Nodes that go on or are to come, none of them after this one, and move one of these objects anyway."""
        live, later = _OPEN | {NodeState.ACTIVE}, {node, *self.facts.dag.find_after(node)}
        names = [name for name in self.facts.graph.order if self.facts.get_state(name) in live and name not in later]
        accepts = {name: self.drafter.compiler.compile_node(name).accept for name in names}
        wanted = [(name, parse_predicate(text)) for name in names for text in accepts[name] if "${" not in text]
        moved = [(name, next(iter_entities(predicate), "")) for name, predicate in wanted if predicate.is_lasting]
        return {name: item for name, item in reversed(moved) if item in objects}

    def plan_anew(self, node: str, world: Environment) -> list[Entry]:
        """The amendment that makes up for a node, and the end of nodes that it replaces; empty without a plan."""
        from phyagentos.agent.planning.answers import PlannedGoal
        from phyagentos.agent.planning.planned import plan_goal

        facts, drafter = self.facts, self.drafter
        waiting = facts.dag.find_after(node)
        replaced = [name for name in facts.graph.order if name in waiting]
        before = [int(found[1]) for name in facts.graph.nodes if (found := re.match(r"anew(\d+)_", name))]
        number = 1 + max(before, default=0)
        if number > PLANS_MAX or not (accept := self._find_rest(node, replaced)):
            return []
        tried = [(s.contract.skill, s.contract.target, s.contract.parameters) for s in facts.get_sessions(node)]
        try:
            planned = plan_goal(self._want(accept), drafter.compiler.catalogue, world, without=tried)
            if not isinstance(planned, PlannedGoal) or not planned.steps:
                return []
            file = keep_graph(self._workspace, self.facts.goal, self._add_steps(planned, node, f"anew{number}_"))
            graph = read_goal_graph(file, drafter.compiler.catalogue)
        except DefinitionError:  # of a form that no plan is made for
            return []
        why = f"the rest of the goal was planned anew after {node}"
        over = [name for name in replaced if facts.get_state(name) in _OPEN]
        skipped = [drafter.note(name, GoalEvent.NODE_SKIPPED, why) for name in over]
        return [self._amend(graph, file.name, why), *skipped]

    def _want(self, accept: tuple[str, ...]) -> WantedGoal:
        spec = self.facts.graph.spec
        fields = spec.model_dump(include={"goal", "objective", "scene", "constraints"})
        targets = {choice.target: choice.target for choice in self.facts.graph.choices.values()}
        return WantedGoal(**fields, targets=targets, accept=accept)

    def _add_steps(self, planned: "PlannedGoal", node: str, prefix: str) -> Fields:
        """The authored graph with the steps of a plan as nodes that run on the failure of one."""
        authored, graph = self._read_authored(), self.facts.graph
        role_of = {choice.target: graph.nodes[name].spec.target for name, choice in graph.choices.items()}
        nodes = {
            prefix + step.name: {
                "after": [{"node": node, "on": "failure"}, *(prefix + before for before in step.after)],
                "skill": step.skill,
                "target": role_of[step.target],
                "with": dict(step.parameters),
                "accept": list(step.accept),
            }
            for step in planned.steps
        }
        accept = authored.get("accept") or list(planned.wanted.accept)
        return {**authored, "sessions": authored["sessions"] | nodes, "accept": accept}

    def _find_rest(self, node: str, replaced: list[str]) -> tuple[str, ...]:
        """What must be true in the end and no other open node brings about."""
        facts, compiler = self.facts, self.drafter.compiler
        texts = dict.fromkeys(facts.graph.spec.accept)
        if not texts:
            own = [compiler.compile_node(name).accept for name in (node, *replaced)]
            own += [session.accept for session in facts.find_finished().values()]
            promised = (text for accept in own for text in accept if "${" not in text)  # of what is known by now
            texts = dict.fromkeys(text for text in promised if parse_predicate(text).is_lasting)
        others = [name for name in facts.graph.nodes if name not in {node, *replaced}]
        live = [name for name in others if facts.get_state(name) in _OPEN | {NodeState.ACTIVE}]
        coming = {text for name in live for text in compiler.compile_node(name).accept}
        return tuple(text for text in texts if text not in coming)

    def _read_authored(self) -> Any:
        """The present graph as it is written."""
        return read_yaml(find_graph(self._workspace, self.facts.ledger.goals[self.facts.goal])).data

    @property
    def _workspace(self) -> Workspace:
        return Workspace(self.evidence.root)

    def _amend(self, graph: GoalGraph, file: str, reason: str) -> Entry:
        """The record that takes a graph over."""
        body = {"file": file, **compute_difference(graph, self.facts.nodes), "reason": reason}
        return self.facts.note(GoalEvent.GOAL_AMENDED, body)
