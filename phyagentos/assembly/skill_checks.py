"""Problems of a SKILL.md beyond its form (predicates, parameters, the tree); preflight checks them again."""

from collections.abc import Iterator
from pathlib import Path

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.graph import GoalGraph
from phyagentos.agent.goals.places import iter_too_large, iter_unmeasured
from phyagentos.errors import DefinitionError, Problem, format_names
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime, read_skill
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.capabilities.trees import Tree, read_tree
from phyagentos.protocol.documents.schema import Address, Located
from phyagentos.protocol.documents.yaml_scalars import format_scalar
from phyagentos.protocol.predicates.library import ArgumentKind
from phyagentos.protocol.predicates.predicate import parse_predicate, substitute
from phyagentos.runtime.execution.leaf_registry import read_registry
from phyagentos.runtime.execution.ports import Port, find_misfit
from phyagentos.runtime.execution.tree_check import find_ranges

TARGET_WORD = "target"  # `${target}` is the session's own target


def check_skill(path: Path, library: Library) -> list[Problem]:
    """Every problem of one SKILL.md."""
    try:
        skill, located = read_skill(path)
    except DefinitionError as error:
        return list(error.problems)
    beside = [*_check_needs(skill, located, library), *_check_tree(skill, located, library)]
    return [*_check_predicates(skill, located), *beside]


def check_arguments(graph: GoalGraph, located: Located, catalogue: Catalogue, library: Library) -> Iterator[Problem]:
    """Numbers out of the range of the ports that read them, through trees and subtrees; objects larger than a place."""
    registry, scene = read_registry(library), catalogue.find_scene(graph.spec.scene)
    if scene is None:  # which is reported elsewhere
        return
    for index, text in enumerate(graph.spec.accept):
        yield from iter_too_large(located, ("accept", index), text, scene)
    for name, choice in graph.choices.items():
        skill, path = catalogue.skills[choice.skill], graph.nodes[name].path
        tree = read_tree(library.get_tree(skill.tree)) if skill.kind == "builtin" else None
        ranges = find_ranges(tree, library, registry) if tree is not None else {}
        for key, value in choice.parameters.items():
            yield from _iter_misfits(located, (*path, "with", key), value, ranges.get(key))
        for text in skill.guarantees:
            yield from iter_too_large(located, (*path, "with"), substitute(text, choice.parameters), scene)


def _iter_misfits(located: Located, path: Address, value: object, port: Port | None) -> Iterator[Problem]:
    if port is not None and (expected := find_misfit(value, port)):
        yield located.problem("INVALID_VALUE", path, format_scalar(value), expected, port.description)


def _check_predicates(skill: SkillRuntime, located: Located) -> Iterator[Problem]:
    known = [*skill.parameters, TARGET_WORD]
    for key in ("requires", "hold", "guarantees"):
        for index, text in enumerate(getattr(skill, key)):
            address: Address = (key, index)
            try:
                predicate = parse_predicate(text, address=located.address_of(address), template=True)
            except DefinitionError as error:
                yield from error.problems
                continue
            yield from iter_unmeasured(located, address, text)
            yield from _iter_targets_as_objects(skill, located, address, text)
            for name in predicate.variables:
                if name not in known:
                    found = f"'${{{name}}}' in {text!r}"
                    fix = f"Declare {name!r} among the parameters, or write one of these."
                    yield Problem.unknown("parameter", located.address_of(address), name, known, found, fix=fix)


def _iter_targets_as_objects(skill: SkillRuntime, located: Located, at: Address, text: str) -> Iterator[Problem]:
    """The session's own target where an object or a place is asked for, and a parameter that lacks its brackets."""
    written = parse_predicate(text.replace(f"${{{TARGET_WORD}}}", TARGET_WORD), template=True)
    for each in () if TARGET_WORD in skill.parameters else written.iter_references():
        if each.name in skill.parameters:
            wanted = f"a name of the scene, or the parameter '${{{each.name}}}'"
            yield located.problem("INVALID_VALUE", at, f"{each.name!r} in {text!r}", wanted, "It stands in ${ }.")
        if each.name == TARGET_WORD and each.kind is not ArgumentKind.TARGET:
            found = f"{TARGET_WORD!r}, the session's own target, as {each.kind} in {text!r}"
            known = (f"${{{name}}}" for name in skill.parameters)
            yield located.problem(
                "INVALID_VALUE", at, found, f"a parameter: {format_names(known)}", "Write one of these."
            )


def _check_needs(skill: SkillRuntime, located: Located, library: Library) -> Iterator[Problem]:
    """What no robot here has: every session would be refused."""
    profiles = [profile for name in library.names_of_targets() if (profile := _find_profile(library, name))]
    for key in ("observations", "actions"):
        known = {each for profile in profiles for each in getattr(profile, key)}
        for index, name in enumerate(getattr(skill.needs, key)):
            if name not in known:
                yield located.unknown(key.removesuffix("s"), ("needs", key, index), name, known)


def _find_profile(library: Library, name: str) -> TargetProfile | None:
    try:
        return read_target(library.get_target(name))
    except DefinitionError:
        return None


def _check_tree(skill: SkillRuntime, located: Located, library: Library) -> Iterator[Problem]:
    if skill.policy is not None:
        how, at = skill.policy.execution, ("policy", "execution")
        if how.begins_after and how.begins_after not in (known := library.names_of_skills()):
            yield located.unknown("skill", (*at, "begins_after"), how.begins_after, known)
        if how.aim and how.aim not in skill.parameters:
            yield located.unknown("parameter", (*at, "aim"), how.aim, skill.parameters)
    for index, name in enumerate(skill.loop.tools if skill.loop is not None else ()):
        if name not in (known := library.names_of_skills()):
            yield located.unknown("skill", ("loop", "tools", index), name, known)
    if skill.kind != "builtin":
        return
    names = library.names_of_trees()
    if skill.tree not in names:
        yield located.unknown("tree", ("tree",), skill.tree, names)
        return
    try:
        tree = read_tree(library.get_tree(skill.tree))
    except DefinitionError as error:
        yield from error.problems
        return
    yield from _check_ports(skill, located, tree)
    ranges = find_ranges(tree, library, read_registry(library))
    for key, parameter in skill.parameters.items():
        yield from _iter_misfits(located, ("parameters", key, "default"), parameter.default, ranges.get(key))


def _check_ports(skill: SkillRuntime, located: Located, tree: Tree) -> Iterator[Problem]:
    """The skill must feed every input of its tree, and the tree must make every output of the skill."""
    for name, port in tree.header.inputs.items():
        if name not in skill.parameters and not port.optional and port.default is None:
            hint = f"The tree {skill.tree!r} reads it."
            yield located.problem("MISSING_VALUE", ("parameters",), "nothing", f"parameter {name!r}", hint)
    for name in skill.outputs:
        if name not in tree.header.outputs:
            found = f"{name!r}, which the tree {skill.tree!r} does not make"
            yield located.unknown("output", ("outputs", name), name, tree.header.outputs, found)
