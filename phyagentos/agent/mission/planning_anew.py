"""Planning anew: where no repair of a node is left, the rest of the goal is planned from the present world.

The goal is amended by nodes that run on the failure of that node, so that they make up for it; what waited for it is
left out.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from phyagentos.agent.goals.graph import read_goal_graph
from phyagentos.agent.goals.wanted import WantedGoal
from phyagentos.agent.mission.drafting import Drafter
from phyagentos.agent.mission.goal_facts import GoalFacts
from phyagentos.errors import DefinitionError
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.sessions.tasks import NodeState
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.predicates.predicate import parse_predicate
from phyagentos.store.admission import Entry, GoalEvent

if TYPE_CHECKING:
    from phyagentos.agent.planning.planned import PlannedGoal

PLANS_MAX = 2  # of one goal
_PREFIX = "anew"
_OPEN = frozenset({NodeState.WAITING, NodeState.READY, NodeState.INVALIDATED})


@dataclass(frozen=True, slots=True, kw_only=True)
class Replanner:
    """Plans the rest of one goal."""

    facts: GoalFacts
    drafter: Drafter

    def find_unmet(self, session: Session, world: Environment) -> tuple[str, ...]:
        """What a session needs of the world and lacks now, so that no other way of carrying it out can help."""
        from phyagentos.agent.planning.domain import build_domain

        accept = tuple(text for text in session.accept if parse_predicate(text).is_lasting)
        try:
            domain = build_domain(self._want(accept), self.drafter.compiler.catalogue, world) if accept else None
        except DefinitionError:  # of a form that no plan is made for
            domain = None
        return domain.find_unmet((session.skill, session.target, session.parameters)) if domain is not None else ()

    def plan(self, node: str, world: Environment) -> list[Entry]:
        """The amendment that makes up for a node, and the end of nodes that it replaces; empty without a plan."""
        from phyagentos.agent.planning.planned import PlannedGoal, plan_goal

        facts, drafter = self.facts, self.drafter
        waiting = facts.dag.find_after(node)
        replaced = [name for name in facts.graph.order if name in waiting]
        number = 1 + max((_read_number(name) for name in facts.graph.nodes), default=0)
        if number > PLANS_MAX or not (accept := self._find_rest(node, replaced)):
            return []
        tried = [(s.contract.skill, s.contract.target, s.contract.parameters) for s in facts.get_sessions(node)]
        try:
            planned = plan_goal(self._want(accept), drafter.compiler.catalogue, world, without=tried)
            if not isinstance(planned, PlannedGoal) or not planned.steps:
                return []
            file = drafter.keep_graph(self._add_steps(planned, node, f"{_PREFIX}{number}_"))
            graph = read_goal_graph(file, drafter.compiler.catalogue)
        except DefinitionError:  # of a form that no plan is made for
            return []
        why = f"the rest of the goal was planned anew after {node}"
        over = [name for name in replaced if facts.get_state(name) in _OPEN]
        skipped = [drafter.note(name, GoalEvent.NODE_SKIPPED, why) for name in over]
        return [drafter.amend(graph, file.name, why), *skipped]

    def _want(self, accept: tuple[str, ...]) -> WantedGoal:
        spec = self.facts.graph.spec
        fields = {key: getattr(spec, key) for key in ("goal", "objective", "scene", "constraints")}
        targets = {choice.target: choice.target for choice in self.facts.graph.choices.values()}
        return WantedGoal(**fields, targets=targets, accept=accept)

    def _add_steps(self, planned: "PlannedGoal", node: str, prefix: str) -> dict[str, Any]:
        """The authored graph with the steps of a plan as nodes that run on the failure of one."""
        authored, graph = self.drafter.read_authored(), self.facts.graph
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


def _read_number(name: str) -> int:
    number = name.removeprefix(_PREFIX).partition("_")[0] if name.startswith(_PREFIX) else ""
    return int(number) if number.isdigit() else 0
