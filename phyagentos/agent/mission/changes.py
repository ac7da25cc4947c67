"""Changes of a goal's graph while it is pursued: asked for by a person, or decided on what is seen.

A change is one record with the difference, and a file in `goals/` with the whole graph, which is read from then on.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from phyagentos.agent.goals.amendment import find_contradictions, find_fitting, set_values
from phyagentos.agent.goals.graph import read_goal_graph
from phyagentos.agent.goals.selector import ANY
from phyagentos.agent.judging.goal_judgement import Evidence, Seen
from phyagentos.agent.judging.judges.predicates import evaluate_on
from phyagentos.agent.mission.drafting import Drafter, join
from phyagentos.agent.mission.goal_facts import GoalFacts
from phyagentos.agent.mission.recovery import Recovery
from phyagentos.agent.mission.task_document import TaskEdit
from phyagentos.errors import DefinitionError
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.predicates.predicate import View, parse_predicate, substitute
from phyagentos.protocol.world.truth import Truth
from phyagentos.store.admission import Entry, GoalEvent


@dataclass(frozen=True, slots=True, kw_only=True)
class Changes:
    """Decides on changes of one goal's graph."""

    facts: GoalFacts
    drafter: Drafter
    evidence: Evidence
    recovery: Recovery

    def answer(self, file: str) -> list[Entry]:
        """The graph in `goals/` that a person wants, taken over or refused."""
        try:
            wanted = read_goal_graph(Workspace(self.evidence.root).goals / file, self.drafter.compiler.catalogue)
            problems = [*find_contradictions(self.facts.graph, wanted, self.facts.ledger.goals[self.facts.goal])]
        except DefinitionError as error:
            problems = list(error.problems)
        if problems:
            why = f"refused: {join(map(str, problems))}"
            return [self.facts.note(GoalEvent.AMENDMENT_REFUSED, {"file": file, "reason": why})]
        return [self.drafter.amend(wanted, file, "as a person asked for")]

    def ask(self, edit: TaskEdit) -> list[Entry]:
        """An edit of TASK.md as a graph that a person wants; `answer` follows."""
        authored = self.drafter.read_authored()
        sessions = {name: dict(node) for name, node in authored["sessions"].items() if name not in edit.removed}
        foreign = [*edit.foreign, *({*edit.removed, *edit.after} - authored["sessions"].keys())]
        if foreign:
            why = f"TASK.md: {', '.join(foreign)} cannot be changed there; write the graph, and use `paos amend`"
            return [self.facts.note(GoalEvent.AMENDMENT_REFUSED, {"reason": f"refused: {why}"})]
        for name, node in sessions.items():
            edges = [each for each in node.get("after", ()) if isinstance(each, dict)]
            before = edit.after.get(name, [each for each in node.get("after", ()) if isinstance(each, str)])
            node["after"] = [*(each for each in before if each not in edit.removed), *edges]
        file = self.drafter.keep_graph(authored | edit.judged | {"sessions": sessions})
        return [self.facts.note(GoalEvent.AMENDMENT_ASKED, {"file": file.name})]

    def is_conditional(self, name: str) -> bool:
        """Whether what is seen decides on a node once it is ready."""
        return self.facts.graph.nodes[name].is_conditional and not self.facts.get_ids(name)

    def decide(self, name: str, *, is_quiet: bool) -> list[Entry] | None:
        """What follows for a ready node whose condition is decided on what is seen.

        None where it may become a session; empty while its condition cannot be told, and sessions live (not `is_quiet`)
        beside which none may look.
        """
        seen = self._find_seen(name)
        criteria = self._judge(name, seen)
        if false := next((each for each in criteria if each.truth is Truth.FALSE), None):
            return [self.drafter.note(name, GoalEvent.NODE_SKIPPED, f"{false.text} is false: {false.because}")]
        if unknown := [each for each in criteria if each.truth is Truth.UNKNOWN]:
            if not is_quiet:
                return []
            looks = self.recovery.look_for(unknown, seen.now) if seen.now is not None else []
            why = f"its condition cannot be told: {unknown[0].text}: {unknown[0].because}"
            return looks or self.drafter.block(name, why)
        return self._fan_out(name, seen) if self.facts.graph.nodes[name].is_open else None

    def _fan_out(self, name: str, seen: Seen) -> list[Entry]:
        """The nodes that a fan-out becomes, or its end where nothing fits."""
        node = self.facts.graph.nodes[name]
        asked = "; ".join(text for text in node.spec.foreach.values() if isinstance(text, str))
        fitting = find_fitting(node, self._roles, self._view(name, seen)) if seen.now is not None else {}
        if not fitting or not all(fitting.values()):
            return [self.drafter.note(name, GoalEvent.NODE_SKIPPED, f"nothing is seen that fits {asked}")]
        file = self.drafter.keep_graph(set_values(self.drafter.read_authored(), node, fitting))
        try:
            graph = read_goal_graph(file, self.drafter.compiler.catalogue)
        except DefinitionError as error:
            return self.drafter.block(name, str(error))
        names = ", ".join(each for each in graph.nodes if each not in self.facts.graph.nodes)
        return [self.drafter.amend(graph, file.name, f"{name} becomes {names}: seen to fit {asked}")]

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
        for status in self.facts.find_ended():
            self.evidence.take_in(status)
        own = self.evidence.by_target.get(self.facts.graph.choices[name].target)
        return own if own is not None and own.now is not None else self.evidence.all

    @property
    def _roles(self) -> Mapping[str, str]:
        return {role: target for role, target in self.facts.graph.spec.targets.items() if target != ANY}
