"""Checks of a goal graph beyond its form: names, types, predicates, promises; every problem in one reading."""

from collections.abc import Iterable, Iterator, Mapping

import networkx as nx

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.expansion import DataEdge, Node, Path
from phyagentos.agent.goals.selector import ANY, Choice, select
from phyagentos.agent.goals.spec import NAME_MAX, REFERENCE, GoalSpec, Promise
from phyagentos.errors import DefinitionError, Problem, format_hint, format_names
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime, find_mismatch
from phyagentos.protocol.documents.schema import Located
from phyagentos.protocol.world.predicates.library import ArgumentKind
from phyagentos.protocol.world.predicates.predicate import parse_predicate, substitute


def check_spec(spec: GoalSpec, nodes: Mapping[str, Node], located: Located, catalogue: Catalogue) -> Iterator[Problem]:
    """Problems of name, scene, roles and every predicate."""
    if len(spec.goal) > NAME_MAX:
        yield located.problem("INVALID_NAME", ("goal",), repr(spec.goal), f"at most {NAME_MAX} letters")
    if spec.scene not in catalogue.scenes:
        yield _unknown(located, "UNKNOWN_SCENE", ("scene",), spec.scene, catalogue.scenes)
    for role, target in spec.targets.items():
        if target != ANY and target not in catalogue.targets:
            yield _unknown(located, "UNKNOWN_TARGET", ("targets", role), target, [*catalogue.targets, ANY])
    names = catalogue.find_scene_names(spec.scene)
    targets = {*spec.targets, *catalogue.targets, "target"}
    for path, text in _iter_predicates(spec, nodes):
        yield from _check_predicate(path, text, located, names, targets)


def check_bindings(
    spec: GoalSpec,
    nodes: Mapping[str, Node],
    dag: "nx.DiGraph[str]",
    order: Iterable[str],
    located: Located,
    catalogue: Catalogue,
) -> tuple[dict[str, Choice], list[Problem]]:
    """Skill and target of each node in the order of the graph, and the problems of these and their arguments."""
    choices: dict[str, Choice] = {}
    problems: list[Problem] = []
    names = catalogue.find_scene_names(spec.scene)
    for name in order:
        node = nodes[name]
        try:
            choices[name] = _choose(spec, node, dag, nodes, choices, located, catalogue)
        except DefinitionError as error:
            problems += error.problems
            continue
        runtime = catalogue.skills[choices[name].skill]
        problems += _check_arguments(node, choices[name], runtime, located, names)
        problems += _check_data_edges(node, runtime, choices, located, catalogue)
        if not node.spec.accept and not runtime.guarantees:
            hint = "Add 'accept': a session without a criterion can never succeed."
            problems.append(located.problem("NOTHING_TO_ACCEPT", node.path, "no acceptance", "a predicate", hint))
    return {name: choices[name] for name in nodes if name in choices}, problems


def _choose(
    spec: GoalSpec,
    node: Node,
    dag: "nx.DiGraph[str]",
    nodes: Mapping[str, Node],
    choices: Mapping[str, Choice],
    located: Located,
    catalogue: Catalogue,
) -> Choice:
    problems: list[Problem] = []
    wanted, skill = node.spec.target, node.spec.skill
    target = spec.targets.get(wanted, wanted)
    if target != ANY and target not in catalogue.targets:
        possible = [*spec.targets, *catalogue.targets, ANY]
        path: Path = ("targets", wanted) if wanted in spec.targets else (*node.path, "target")
        problems.append(_unknown(located, "UNKNOWN_TARGET", path, target, possible))
    if isinstance(skill, str) and skill not in catalogue.skills:
        problems.append(_unknown(located, "UNKNOWN_SKILL", (*node.path, "skill"), skill, catalogue.skills))
    if problems:
        raise DefinitionError(problems)
    address = located.address_of((*node.path, "skill"))
    if isinstance(skill, Promise):  # a promise that is no predicate has been reported with the predicates
        parse_predicate(
            skill.guarantees, address=located.address_of((*node.path, "skill", "guarantees")), template=True
        )
    established = [
        text
        for before in (sorted(nx.ancestors(dag, node.name)) if isinstance(skill, Promise) else ())
        if before in choices
        for text in iter_promises(nodes[before], choices[before], catalogue)
    ]
    return select(skill, target, node.spec.arguments, catalogue, established=established, address=address)


def iter_promises(node: Node, choice: Choice, catalogue: Catalogue) -> Iterator[str]:
    """What holds once a node is done: its own acceptance, then what its skill guarantees."""
    yield from node.spec.accept
    for text in catalogue.skills[choice.skill].guarantees:
        yield substitute(text, {"target": choice.target, **choice.parameters})


def _iter_predicates(spec: GoalSpec, nodes: Mapping[str, Node]) -> Iterator[tuple[Path, str]]:
    yield from ((("constraints", index), text) for index, text in enumerate(spec.constraints))
    for node in nodes.values():
        for key, texts in (("requires", node.spec.requires), ("hold", node.spec.hold), ("accept", node.spec.accept)):
            yield from (((*node.path, key, index), text) for index, text in enumerate(texts))
        if isinstance(node.spec.skill, Promise):
            yield (*node.path, "skill", "guarantees"), node.spec.skill.guarantees
    yield from ((("accept", index), text) for index, text in enumerate(spec.accept))


def _check_predicate(
    path: Path, text: str, located: Located, names: frozenset[str] | None, targets: Iterable[str]
) -> Iterator[Problem]:
    in_node = path[0] == "sessions"
    try:
        predicate = parse_predicate(text, address=located.address_of(path), template=in_node)
    except DefinitionError as error:
        yield from error.problems
        return
    for reference in predicate.iter_references():
        known = targets if reference.kind is ArgumentKind.TARGET else names
        if known is None or reference.name in known:
            continue
        code = "UNKNOWN_TARGET" if reference.kind is ArgumentKind.TARGET else "UNKNOWN_ENTITY"
        found = f"{reference.name!r} at column {reference.column} of {text!r}"
        yield located.problem(code, path, found, format_names(known), format_hint(reference.name, known))


def _check_arguments(
    node: Node, choice: Choice, runtime: SkillRuntime, located: Located, names: frozenset[str] | None
) -> Iterator[Problem]:
    for key in choice.parameters:
        if key not in runtime.parameters:
            yield _unknown(located, "UNKNOWN_PARAMETER", (*node.path, "with", key), key, runtime.parameters)
    for key, parameter in runtime.parameters.items():
        value = choice.parameters.get(key)
        path = (*node.path, "with", key)
        if value is None:
            if not parameter.optional and parameter.default is None:
                found = f"no {key!r} for skill {runtime.skill!r}"
                hint = f"Add {key!r}. {parameter.description}".rstrip()
                yield located.problem("MISSING_PARAMETER", (*node.path, "with"), found, parameter.type, hint)
        elif isinstance(value, str) and REFERENCE.search(value):
            continue  # a data edge: its type is checked with the output
        elif expected := find_mismatch(parameter, value):
            yield located.problem("INVALID_PARAMETER", path, repr(value), expected, parameter.description)
        elif parameter.type in {"entity", "place"} and names is not None and value not in names:
            yield _unknown(located, "UNKNOWN_ENTITY", path, str(value), names)


def _check_data_edges(
    node: Node, runtime: SkillRuntime, choices: Mapping[str, Choice], located: Located, catalogue: Catalogue
) -> Iterator[Problem]:
    for edge in node.data:
        if edge.node not in choices:
            continue
        source = catalogue.skills[choices[edge.node].skill]
        output = source.outputs.get(edge.output)
        if output is None:
            possible = list(source.outputs)
            found = f"{edge.output!r} of node {edge.node!r} (skill {source.skill})"
            hint = format_hint(edge.output, possible)
            yield located.problem("UNKNOWN_OUTPUT", edge.path, found, format_names(possible), hint)
        elif (wanted := _find_wanted_type(edge, node, runtime)) and not _fits(output.type, wanted):
            found = f"output {edge.reference!r}, which is a {output.type}"
            yield located.problem("INVALID_PARAMETER", edge.path, found, f"a {wanted}")


def _find_wanted_type(edge: DataEdge, node: Node, runtime: SkillRuntime) -> str | None:
    """Type of the parameter that an edge fills as a whole, else None."""
    key = edge.path[3] if len(edge.path) == 4 and edge.path[2] == "with" else None
    text = node.spec.arguments.get(str(key))
    whole = isinstance(text, str) and REFERENCE.fullmatch(text.strip())
    return runtime.parameters[str(key)].type if whole and key in runtime.parameters else None


def _fits(offered: str, wanted: str) -> bool:
    return offered == wanted or (offered, wanted) in {("integer", "number"), ("entity", "place"), ("place", "entity")}


def _unknown(located: Located, code: str, path: Path, name: str, known: Iterable[str]) -> Problem:
    names = list(known)
    return located.problem(code, path, repr(name), format_names(names), format_hint(name, names))
