"""Checks of a goal graph beyond its form: names, types, predicates, promises; every problem in one reading."""

import itertools
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import networkx as nx
from msgspec.structs import replace

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.expansion import Node, Path
from phyagentos.agent.goals.places import iter_apart, iter_misplaced, iter_unmeasured
from phyagentos.agent.goals.selector import ANY, Choice, select
from phyagentos.agent.goals.spec import NAME_MAX, REFERENCE, GoalSpec, Promise
from phyagentos.errors import DefinitionError, Problem, format_names, raise_any
from phyagentos.protocol.capabilities.skill_runtimes import Parameter, SkillRuntime, find_mismatch
from phyagentos.protocol.capabilities.targets import find_unshared
from phyagentos.protocol.documents.schema import Located
from phyagentos.protocol.predicates.library import ArgumentKind
from phyagentos.protocol.predicates.predicate import parse_predicate, substitute
from phyagentos.protocol.world.descriptions import parse_description
from phyagentos.protocol.world.environment import UNNAMED

_FITTING = frozenset({("integer", "number"), ("entity", "place"), ("place", "entity")})


class Checks:
    """Checks of one expanded goal graph; none stops the others."""

    def __init__(self, spec: GoalSpec, nodes: Mapping[str, Node], located: Located, catalogue: Catalogue) -> None:
        self.spec, self.nodes, self.located, self.catalogue = spec, nodes, located, catalogue
        self._listed, self._scene = catalogue.find_kinds(spec.scene), catalogue.find_scene(spec.scene)
        self._kinds = None if self._listed is None else self._listed | dict.fromkeys(spec.described, "")
        self._alike = catalogue.find_alike(spec.scene)

    def check_spec(self) -> Iterator[Problem]:
        """Problems of name, scene, roles and every predicate."""
        if len(self.spec.goal) > NAME_MAX:
            yield self.located.problem("INVALID_VALUE", ("goal",), repr(self.spec.goal), f"at most {NAME_MAX} letters")
        if self.spec.scene not in self.catalogue.scenes:
            yield self.located.unknown("scene", ("scene",), self.spec.scene, self.catalogue.scenes)
        for role, target in self.spec.targets.items():
            if target != ANY and target not in self.catalogue.targets:
                yield self.located.unknown("target", ("targets", role), target, [*self.catalogue.targets, ANY])
        for node in self.nodes.values():
            if node.on_failure and not self.spec.accept:  # only the goal's own can say that it is met all the same
                path: Path = (*node.path, "after")
                yield self.located.problem("MISSING_VALUE", path, "an edge on failure", "'accept' of the goal")
            yield from self._check_conditions(node)
        yield from self._check_worlds()
        yield from self._check_interchangeable()
        for name, text in self.spec.described.items():
            path = ("described", name)
            if name in (self._listed or ()) or name.startswith(UNNAMED):
                yield self.located.problem("INVALID_VALUE", path, repr(name), "a name that nothing else may have")
            try:
                parse_description(text, self.located.address_of(path))
            except DefinitionError as error:
                yield from error.problems
        for path, text in self._iter_predicates():
            yield from self.check_predicate(path, text)
        if self._scene is not None:
            wanted = {(): self.spec.accept} | {node.path: node.spec.accept for node in self.nodes.values()}
            for path, texts in wanted.items():
                yield from iter_apart(self.located, (*path, "accept"), texts, self._scene)

    def check_bindings(self, dag: "nx.DiGraph[str]", order: Iterable[str]) -> tuple[dict[str, Choice], list[Problem]]:
        """Skill and target of each node in the order of the graph, and the problems of these and their arguments."""
        choices: dict[str, Choice] = {}
        problems: list[Problem] = []
        for name in order:
            node = self.nodes[name]
            try:
                choices[name] = self._choose(node, dag, choices)
            except DefinitionError as error:
                problems += error.problems
                continue
            runtime = self.catalogue.skills[choices[name].skill]
            problems += self._check_arguments(node, choices[name], runtime)
            problems += self._check_data_edges(node, runtime, choices)
            if not node.spec.accept and not runtime.guarantees:
                hint = "Add 'accept': a session without a criterion can never succeed."
                problems.append(self.located.problem("MISSING_VALUE", node.path, "no acceptance", "a predicate", hint))
        return {name: choices[name] for name in self.nodes if name in choices}, problems

    def _choose(self, node: Node, dag: "nx.DiGraph[str]", choices: Mapping[str, Choice]) -> Choice:
        problems: list[Problem] = []
        wanted, skill = node.spec.target, node.spec.skill
        target = self.spec.targets.get(wanted, wanted)
        if target != ANY and target not in self.catalogue.targets:
            possible = [*self.spec.targets, *self.catalogue.targets, ANY]
            path: Path = ("targets", wanted) if wanted in self.spec.targets else (*node.path, "target")
            problems.append(self.located.unknown("target", path, target, possible))
        if isinstance(skill, str) and skill not in self.catalogue.skills:
            problems.append(self.located.unknown("skill", (*node.path, "skill"), skill, self.catalogue.skills))
        raise_any(problems)
        established: list[str] = []
        earlier: set[str] = set()
        if isinstance(skill, Promise):
            promise = self.located.address_of((*node.path, "skill", "guarantees"))
            parse_predicate(skill.guarantees, address=promise, template=True)  # what is none is reported once
            earlier = nx.ancestors(dag, node.name) & choices.keys() - itertools.chain(*node.on_failure)
        for before in sorted(earlier):
            done = choices[before]
            values = {"target": done.target, **done.parameters}
            promised = (substitute(text, values) for text in self.catalogue.skills[done.skill].guarantees)
            established += (*self.nodes[before].spec.accept, *promised)
        return select(
            skill,
            target,
            node.spec.arguments,
            self.catalogue,
            established=established,
            mechanisms=self.catalogue.find_mechanisms(self.spec.scene),
            address=self.located.address_of((*node.path, "skill")),
        )

    def _check_conditions(self, node: Node) -> Iterator[Problem]:
        """What is decided on what is seen needs a session before it that looks, and a predicate of its variable."""
        path: Path = (*node.path, "when" if node.spec.when else "foreach")
        if (node.spec.when or node.is_open) and not node.predecessors:
            hint = "Let it come after a node that looks: `inspect`, or any other session."
            yield self.located.problem("NOT_OBSERVED", path, "no node before it", "'after'", hint)
        for key, text in node.spec.foreach.items():
            if isinstance(text, str) and (found := set(REFERENCE.findall(text))) != {key}:
                given = ", ".join(f"${{{name}}}" for name in sorted(found)) or "no variable"
                yield self.located.problem(
                    "INVALID_VALUE", (*path, key), f"{given} in {text!r}", f"${{{key}}} and no other variable"
                )

    def _check_worlds(self) -> Iterator[Problem]:
        """Targets of the goal's worlds: known, in one world each, and there by their own profile."""
        placed: dict[str, str] = {}
        for world, names in self.spec.worlds.items():
            for index, name in enumerate(names):
                path, target = ("worlds", world, index), self.spec.targets.get(name, name)
                profile = self.catalogue.targets.get(target)
                if profile is None:
                    yield self.located.unknown("target", path, name, [*self.spec.targets, *self.catalogue.targets])
                elif target in placed:
                    found = f"{target!r} in {placed[target]!r} and in {world!r}"
                    yield self.located.problem("WORLD_CONFLICT", path, found, "one world for each target")
                elif profile.world != world:
                    found = f"{target!r} in {f'the world {profile.world!r}' if profile.world else 'a world of its own'}"
                    hint = f"Write `world: {world}` into robots/{target}/target.yaml."
                    yield self.located.problem("WORLD_CONFLICT", path, found, f"the world {world!r}", hint)
                placed.setdefault(target, world)
        for problem in find_unshared([each for name, each in self.catalogue.targets.items() if name in placed]):
            yield replace(problem, address=self.located.address_of(("worlds",)))

    def _check_interchangeable(self) -> Iterator[Problem]:
        """Groups of two or more objects of the scene that look alike."""
        for index, names in enumerate(self.spec.interchangeable):
            path: Path = ("interchangeable", index)
            if self._kinds is None:
                return
            for name in names:
                if name not in self._kinds:
                    yield self.located.unknown("object", path, name, self._kinds)
                elif len(names) < 2 or set(names) - {name} - self._alike.get(name, frozenset()):
                    alike = format_names(self._alike.get(name, ())).replace("(none)", "nothing else in the scene")
                    expected = "two or more objects of one form and colour"
                    yield self.located.problem(
                        "SCENE_INVALID", path, f"{name!r} in {list(names)}", expected, f"Like {name!r} looks {alike}."
                    )

    def iter_warnings(self) -> Iterator[Problem]:
        """Objects that the goal names and no picture tells from others, unless they are interchangeable."""
        used: dict[str, Path] = {}
        for path, text in self._iter_predicates():
            for reference in parse_predicate(text, template=True).iter_references():
                used.setdefault(reference.name, path)
        for node in self.nodes.values():
            for key, value in node.spec.arguments.items():
                used.setdefault(str(value), (*node.path, "with", key))
        agreed = [set(names) for names in self.spec.interchangeable]
        for name in sorted(used.keys() & self._alike.keys()):
            others = sorted(self._alike[name])
            if not any({name, *others} <= names for names in agreed):
                hint = "Mark one of them, ask for a number of them, or write them into 'interchangeable'."
                found = f"{name!r}, which looks as {', '.join(others)} does"
                yield self.located.problem(
                    "AMBIGUOUS", used[name], found, "an object that differs from the others", hint
                )

    def _iter_predicates(self) -> Iterator[tuple[Path, str]]:
        yield from ((("constraints", index), text) for index, text in enumerate(self.spec.constraints))
        for node in self.nodes.values():
            open_ = ((key, text) for key, text in node.spec.foreach.items() if isinstance(text, str))
            yield from (((*node.path, "foreach", key), text) for key, text in open_)
            for key in ("when", "requires", "hold", "accept"):
                yield from (((*node.path, key, index), text) for index, text in enumerate(getattr(node.spec, key)))
            if isinstance(node.spec.skill, Promise):
                yield (*node.path, "skill", "guarantees"), node.spec.skill.guarantees
        yield from ((("accept", index), text) for index, text in enumerate(self.spec.accept))

    def check_predicate(self, path: Path, text: str) -> Iterator[Problem]:
        """Problems of one predicate: its form, and names that neither scene, roles nor targets hold."""
        in_node = path[0] == "sessions"
        try:
            predicate = parse_predicate(text, address=self.located.address_of(path), template=in_node)
        except DefinitionError as error:
            yield from error.problems
            return
        yield from iter_unmeasured(self.located, path, text)
        if self._scene is not None and "accept" in path:
            yield from iter_misplaced(self.located, path, text, self._scene)
        for reference in predicate.iter_references():
            kind, known = "object", self._kinds and {*self._kinds}
            if reference.kind is ArgumentKind.TARGET:
                kind, known = "target", {*self.spec.targets, *self.catalogue.targets, "target"}
            if known is not None and reference.name not in known:
                found = f"{reference.name!r} at column {reference.column} of {text!r}"
                yield self.located.unknown(kind, path, reference.name, known, found)

    def _check_arguments(self, node: Node, choice: Choice, runtime: SkillRuntime) -> Iterator[Problem]:
        for key in choice.parameters:
            if key not in runtime.parameters:
                yield self.located.unknown("parameter", (*node.path, "with", key), key, runtime.parameters)
        for key, parameter in runtime.parameters.items():
            value = choice.parameters.get(key)
            path = (*node.path, "with", key)
            if value is None:
                if parameter.is_needed:
                    found = f"no {key!r} for skill {runtime.skill!r}"
                    hint = f"Add {key!r}. {parameter.description}".rstrip()
                    yield self.located.problem("MISSING_VALUE", (*node.path, "with"), found, parameter.type, hint)
            elif isinstance(value, str) and REFERENCE.search(value):
                continue  # a data edge: its type is checked with the output
            elif parameter.type == "posture" and value not in (known := self.catalogue.targets[choice.target].postures):
                yield self.located.unknown("posture", path, str(value), known)
            else:
                yield from iter_mismatches(self.located, path, parameter, value, self._kinds)
                if parameter.type == "place" and self._scene is not None:
                    values: Mapping[str, object] = {"target": choice.target, **choice.parameters}
                    promised = [substitute(each, values) for each in runtime.guarantees if f"${{{key}}}" in each]
                    for text in promised:
                        yield from iter_misplaced(self.located, path, text, self._scene)

    def _check_data_edges(self, node: Node, runtime: SkillRuntime, choices: Mapping[str, Choice]) -> Iterator[Problem]:
        for edge in node.data:
            if edge.node not in choices:
                continue
            source = self.catalogue.skills[choices[edge.node].skill]
            output = source.outputs.get(edge.output)
            key = edge.path[3] if len(edge.path) == 4 and edge.path[2] == "with" else None  # filled as a whole, or not
            is_whole = key in runtime.parameters and REFERENCE.fullmatch(str(node.spec.arguments[str(key)]).strip())
            wanted = runtime.parameters[str(key)].type if is_whole else None
            if output is None:
                found = f"{edge.output!r} of node {edge.node!r} (skill {source.skill})"
                yield self.located.unknown("output", edge.path, edge.output, source.outputs, found)
            elif wanted not in (None, output.type) and (output.type, wanted) not in _FITTING:
                found = f"output '{edge.node}.outputs.{edge.output}', which is a {output.type}"
                yield self.located.problem("INVALID_VALUE", edge.path, found, f"a {wanted}")


def iter_mismatches(
    located: Located, path: Path, parameter: Parameter, value: Any, kinds: Mapping[str, str] | None
) -> Iterator[Problem]:
    """What is wrong with a value: type, bounds, or a name that is not in the scene (`kinds`: name -> kind)."""
    if expected := find_mismatch(parameter, value):
        is_one = isinstance(value, list) and len(value) == 1 and not find_mismatch(parameter, value[0])
        hint = f"Write {value[0]}, without brackets." if is_one else parameter.description
        yield located.problem("INVALID_VALUE", path, repr(value), expected, hint)
    elif parameter.type in {"entity", "entities", "place"} and kinds is not None:
        for name in [value] if isinstance(value, str) else value:
            if name not in kinds:
                yield located.unknown("object", path, str(name), kinds)
            elif parameter.kinds and (kind := kinds[name]) and kind not in parameter.kinds:
                fitting = [each for each, other in kinds.items() if other in parameter.kinds]
                expected = f"of kind {' or '.join(parameter.kinds)}: {format_names(fitting)}"
                found = f"{name!r}, of kind {kind}"
                yield located.problem("INVALID_VALUE", path, found, expected, parameter.description)
