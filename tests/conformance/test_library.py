"""Everything that ships is tested by existing: each leaf, each tree, each skill."""

import pytest

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.skill_runtimes import read_skill
from phyagentos.protocol.capabilities.trees import NodeKind, Reference, find_references, iter_nodes, read_tree
from phyagentos.protocol.predicates.library import get_predicate_library
from phyagentos.protocol.predicates.predicate import parse_predicate
from phyagentos.runtime.execution.leaf_registry import build_registry
from phyagentos.runtime.execution.tree_check import check_tree
from phyagentos.testing import check_leaf, check_predicate

LIBRARY = Library.open()
REGISTRY = build_registry(LIBRARY)
LEAVES = REGISTRY.names()
TREES = LIBRARY.names_of_trees()
SKILLS = LIBRARY.names_of_skills()


@pytest.mark.parametrize("name", LEAVES)
def test_a_leaf_is_documented_with_its_ports_and_those_of_its_role(name):
    check_leaf(REGISTRY.get(name))


@pytest.mark.parametrize("definition", list(get_predicate_library()), ids=lambda each: each.name)
def test_a_predicate_is_described_and_not_true_of_what_nothing_shows(definition):
    check_predicate(definition)


@pytest.mark.parametrize("name", TREES)
def test_a_tree_has_no_problem(name):
    assert check_tree(name, LIBRARY, REGISTRY) == []


@pytest.mark.parametrize("name", TREES)
def test_every_input_of_a_tree_is_used_and_described(name):
    tree = read_tree(LIBRARY.get_tree(name))
    nodes = list(iter_nodes(tree.root))
    used = {value.key for node in nodes for value in node.wiring.values() if isinstance(value, Reference)}
    used |= {key for node in nodes for key in find_references(node.text)}

    assert set(tree.header.inputs) <= used
    assert all(port.description for port in (*tree.header.inputs.values(), *tree.header.outputs.values()))


@pytest.mark.parametrize("name", SKILLS)
def test_a_skills_parameters_and_outputs_are_those_of_its_tree(name):
    skill, _ = read_skill(LIBRARY.get_skill(name))
    header = read_tree(LIBRARY.get_tree(skill.tree)).header

    assert {n: p.type for n, p in skill.parameters.items()} == {n: p.type for n, p in header.inputs.items()}
    assert {n: p.optional for n, p in skill.parameters.items()} == {n: p.optional for n, p in header.inputs.items()}
    assert {n: p.default for n, p in skill.parameters.items()} == {n: p.default for n, p in header.inputs.items()}
    assert set(skill.outputs) <= set(header.outputs)


@pytest.mark.parametrize("name", SKILLS)
def test_every_reference_in_a_skills_predicates_is_a_parameter(name):
    skill, _ = read_skill(LIBRARY.get_skill(name))

    for text in (*skill.requires, *skill.hold, *skill.guarantees):
        assert set(find_references(text)) <= set(skill.parameters), text
        parse_predicate(text, template=True)


@pytest.mark.parametrize("name", SKILLS)
def test_a_skill_says_what_it_does_beyond_its_front_matter(name):
    text = LIBRARY.get_skill(name).read_text(encoding="utf-8")

    body = text.split("---\n", 2)[2]
    assert len(body.split()) > 20


def test_at_least_one_shipped_tree_uses_each_leaf_or_it_is_a_building_block():
    used = {n.type for t in TREES for n in iter_nodes(read_tree(LIBRARY.get_tree(t)).root) if n.kind is NodeKind.LEAF}

    assert set(LEAVES) - used == {"call"}
