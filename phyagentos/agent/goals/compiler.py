"""Compiles a ready node into a session contract, which preflight checks before anything moves. Paper section 3.3.

The contract is fully substituted: it holds no `${...}`, no role and no default of the goal.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.expansion import iter_strings, substitute_value
from phyagentos.agent.goals.graph import GoalGraph
from phyagentos.agent.goals.selector import ANY, Choice
from phyagentos.agent.goals.spec import REFERENCE, NodeSpec
from phyagentos.errors import DefinitionError, Problem, raise_any
from phyagentos.protocol.capabilities.placed_scenes import name_placed
from phyagentos.protocol.capabilities.skill_runtimes import ParameterRole, SkillRuntime, find_parameter
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.predicates.predicate import has_metric, parse_predicate, substitute
from phyagentos.protocol.predicates.syntax import format_value
from phyagentos.protocol.sessions.calibration import TrackRecord
from phyagentos.protocol.sessions.lookahead import LookaheadRequest
from phyagentos.protocol.sessions.session import GoalId, Limits, Scene, Session, SessionId
from phyagentos.protocol.sessions.strategy import DEFAULT_STRATEGY, Strategy
from phyagentos.protocol.sessions.tasks import compute_session_id
from phyagentos.protocol.world.seeds import compute_seed

Outputs = Mapping[str, Mapping[str, Any]]  # node -> output -> value
_NOTHING = NodeSpec(skill="")


@dataclass(frozen=True, slots=True, kw_only=True)
class Revision:
    """What a session does differently from its node, or a child from its parent.

    Attributes:
        parent: None for the first session of a node.
        requires: None keeps those of skill and node.
        choice: None keeps the node's own skill, target and parameters.
        purpose: What it prepares (`inspect`, `clear`); empty when it pursues the node's objective.
        lead: Added to the priority.
        threshold: Of its look-ahead; None keeps the node's, 0 accepts every forecast.
    """

    parent: SessionId | None
    strategy: Strategy = DEFAULT_STRATEGY
    requires: tuple[str, ...] | None = None
    reasons: tuple[str, ...] = ()
    choice: Choice | None = None
    purpose: str = ""
    lead: int = 0
    threshold: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionCompiler:
    """Compiles the nodes of one goal, whose id is also the episode, so that its sessions share one world.

    Its sessions do not ask `distrusted` forecasters.
    """

    graph: GoalGraph
    catalogue: Catalogue
    goal: GoalId
    seed: int
    distrusted: Mapping[str, TrackRecord] = field(default_factory=dict)

    def compile_node(
        self, name: str, *, outputs: Outputs | None = None, attempt: int = 0, revision: Revision | None = None
    ) -> Session:
        """The contract of one node; without the outputs of those before it, data edges stay as they are written.

        Raises:
            DefinitionError: An output of a data edge is missing, or leads to an invalid predicate.
        """
        node, revision = self.graph.nodes[name], revision or Revision(parent=None)
        own, purpose, of_goal = self.graph.choices[name], revision.purpose, self.graph.spec
        choice = revision.choice or own
        skill = self.catalogue.skills[choice.skill]
        promiser = skill if purpose else self.catalogue.skills[own.skill]  # another skill must keep the same promise
        parameters, resolve = self._bind(name, choice, purpose, outputs)
        limits = msgspec.convert(of_goal.defaults, Limits, from_attributes=True)
        limits = msgspec.structs.replace(limits, timeout_s=node.spec.timeout_s or limits.timeout_s)
        spec = node.spec if not purpose else _NOTHING  # what prepares a node does not pursue its objective
        return Session(
            id=compute_session_id(self.goal, name, attempt),
            goal=self.goal,
            node=name,
            parent=revision.parent,
            attempt=attempt,
            objective=substitute(spec.objective, resolve.values) or _describe(choice.skill, parameters),
            skill=choice.skill,
            target=choice.target,
            parameters=parameters,
            acts_on=find_parameter(skill, ParameterRole.OBJECT),
            requires=resolve((*skill.requires, *spec.requires)) if revision.requires is None else revision.requires,
            hold=resolve((*skill.hold, *spec.hold, *of_goal.constraints)),
            accept=resolve((*spec.accept, *promiser.guarantees)),
            scene=Scene(
                name=name_placed(of_goal.scene, map(self.catalogue.targets.get, of_goal.targets.values())),
                seed=self.seed,
                episode=self.goal,
                described=of_goal.described,
            ),
            seed=compute_seed(self.seed, "node", name, "attempt", attempt),
            limits=limits,
            strategy=revision.strategy,
            priority=node.spec.priority + revision.lead,
            resources=tuple(dict.fromkeys((*skill.needs.resources, *spec.resources))),
            reset_policy=of_goal.defaults.reset_policy,
            purpose=purpose,
            lookahead=self._ask_ahead(name, attempt, revision),
            unless_met=not purpose and not spec.even_if_met and _wants_state(promiser, spec),
            interchangeable=of_goal.interchangeable,
            coming=() if purpose else self.graph.find_coming(name),
            kept=self.graph.kept if name in self.graph.brought and not purpose else (),
        )

    def _bind(self, name: str, choice: Choice, purpose: str, outputs: Outputs | None) -> "tuple[Fields, _Resolver]":
        """The arguments of a session in the order of its skill, and what puts them into its predicates."""
        node, own = self.graph.nodes[name], self.graph.choices[name]
        skills = [self.catalogue.skills[choice.skill], *([] if purpose else [self.catalogue.skills[own.skill]])]
        values = {
            f"{source}.outputs.{output}": value
            for source, found in (outputs or {}).items()
            for output, value in found.items()
        }
        given = substitute_value(choice.parameters, values)
        if outputs is not None:
            _check_resolved(given, self.goal, name)
        meant = {key: p.default for key, p in skills[0].parameters.items() if p.default is not None} | given
        parameters = {key: meant[key] for key in skills[0].parameters if key in meant}
        authored = {} if purpose else {**node.spec.arguments, **substitute_value(own.parameters, values)}
        known = {**authored, **parameters, **values, "target": choice.target}
        omitted = tuple(key for skill in skills for key in skill.parameters if key not in known)
        roles = {role: choice.target if target == ANY else target for role, target in self.graph.spec.targets.items()}
        roles["target"] = choice.target
        return parameters, _Resolver(known, roles, omitted, f"{self.goal}.{name}", preview=outputs is None)

    def _ask_ahead(self, name: str, attempt: int, revision: Revision) -> LookaheadRequest | None:
        """Look-ahead of a session; preparing sessions have none."""
        own = self.graph.nodes[name].spec.lookahead
        asked = self.graph.spec.defaults.lookahead if own is None else own
        if not asked or revision.purpose:
            return None
        return LookaheadRequest(
            samples=asked.samples,
            threshold=asked.threshold if revision.threshold is None else revision.threshold,
            seed=compute_seed(self.seed, "node", name, "attempt", attempt),
            forecasters=asked.forecasters,
            distrusted=dict(self.distrusted),
        )

    @property
    def asks_ahead(self) -> bool:
        """Whether any session of the goal asks for look-ahead."""
        return any(self._ask_ahead(name, 0, Revision(parent=None)) for name in self.graph.nodes)

    def preview(self) -> tuple[Session, ...]:
        """The first session of every node in order, but of those that fan out over what is seen."""
        return tuple(self.compile_node(name) for name in self.graph.order if not self.graph.nodes[name].is_open)


@dataclass(frozen=True, slots=True)
class _Resolver:
    """Substitutes, normalizes and deduplicates the predicates of one contract.

    A predicate of the skill is left out when it names an optional parameter without a value.
    """

    values: Mapping[str, Any]
    roles: Mapping[str, str]
    omitted: Sequence[str]
    address: str
    preview: bool

    def __call__(self, texts: Iterable[str]) -> tuple[str, ...]:
        resolved: dict[str, None] = {}
        problems: list[Problem] = []
        for text in texts:
            if any(f"${{{key}}}" in text for key in self.omitted):
                continue
            try:
                filled = substitute(text, self.values)
                predicate = parse_predicate(filled, address=self.address, template=self.preview)
                resolved[predicate.rename_targets(self.roles).text] = None
            except DefinitionError as error:
                problems += error.problems
        raise_any(problems)
        return tuple(resolved)


def _wants_state(skill: SkillRuntime, spec: NodeSpec) -> bool:
    """Whether a node wants a state of the world, which may be there already, rather than the act itself.

    The guarantees of its skill decide: a lasting state (`inside`, `closed`) is wanted for itself; a passing fact
    (`visible`, `holding`), or none, is the mark of the act. A node that measures the act (`metric`) wants the act, too.
    """
    promised = [parse_predicate(text, template=True) for text in skill.guarantees]
    return bool(promised) and all(each.is_lasting for each in promised) and not any(map(has_metric, spec.accept))


def _check_resolved(parameters: Mapping[str, object], goal: GoalId, node: str) -> None:
    expected = "an output that the session before left"
    problems = [
        Problem("MISSING_VALUE", f"{goal}.{node}: {'.'.join(map(str, path))}", f"no value for {reference}", expected)
        for path, text in iter_strings(parameters)
        for reference in REFERENCE.findall(text)
    ]
    raise_any(problems)


def _describe(skill: str, parameters: Mapping[str, object]) -> str:
    """A sentence such as `Pick and place: object red_cube, destination red_tray.`."""
    title = skill.replace("_", " ").capitalize()
    arguments = ", ".join(f"{key.replace('_', ' ')} {format_value(value)}" for key, value in parameters.items())
    return f"{title}: {arguments}." if arguments else f"{title}."
