"""BehaviorTree.CPP itself, by its Python binding `behaviortreepy`, reads every tree that ships and ticks it in order.

The binding registers nodes without ports, so that trees are verified as they are, and ticked with the values of ports
taken out. It knows no control nodes of others: no tree that ships has a `parallel`.
"""

import xml.etree.ElementTree as ET

import pytest

from phyagentos.export.bt_xml import render_trees
from phyagentos.operations.behaviour_trees import iter_leaf_models
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.trees import NodeKind
from phyagentos.runtime.execution.leaf_registry import build_registry
from phyagentos.runtime.execution.tree_check import read_sound_trees

pytestmark = pytest.mark.extras
LIBRARY = Library.open()
REGISTRY = build_registry(LIBRARY)
SUCCEED, FAIL = True, False


@pytest.fixture
def bt():
    return pytest.importorskip("behaviortreepy", reason="needs the package behaviortreepy: make test-extras")


def register(bt, root, ticked, outcome):
    """A factory that knows the nodes of the file's model; each leaf notes its path and ends as `outcome` says."""
    factory = bt.BehaviorTreeFactory()
    status = {SUCCEED: bt.NodeStatus.SUCCESS, FAIL: bt.NodeStatus.FAILURE}

    def tick(node):
        ticked.append(node.name())
        return status[outcome]

    for model in root.find("TreeNodesModel"):
        name = model.get("ID")
        if model.tag == "Action":
            factory.register_simple_action(name, tick)
        elif model.tag == "Condition":
            factory.register_simple_condition(name, tick)
        elif model.tag == "Decorator":
            factory.register_simple_decorator(name, lambda child, _: child)
    return factory


def follow(node, trees, outcome, ticked):
    """The names of the leaves that are ticked when each ends as `outcome` says; whether the node succeeds."""
    below = [lambda child=child: follow(child, trees, outcome, ticked) for child in node.children]
    match node.kind:
        case NodeKind.SUBTREE:
            return follow(trees[node.type].root, trees, outcome, ticked)
        case NodeKind.SEQUENCE | NodeKind.REACTIVE_SEQUENCE:
            return all(tick() for tick in below)
        case NodeKind.FALLBACK | NodeKind.REACTIVE_FALLBACK:
            return any(tick() for tick in below)
        case NodeKind.RETRY:
            return any(below[0]() for _ in range(int(node.amount)))
        case NodeKind.REPEAT:
            return all(below[0]() for _ in range(int(node.amount)))
        case NodeKind.INVERT:
            return not below[0]()
        case NodeKind.FOR_EACH | NodeKind.TIMEOUT | NodeKind.COOLDOWN:
            return below[0]()
        case NodeKind.LEAF | NodeKind.CONDITION:
            ticked.append(node.name)
            return outcome
    raise AssertionError(node.kind)


@pytest.mark.parametrize("name", LIBRARY.names_of_trees())
def test_every_tree_is_verified_as_it_is_written(name, bt):
    trees = read_sound_trees(name, LIBRARY, REGISTRY)
    text = render_trees(list(trees.values()), dict(iter_leaf_models(REGISTRY)))
    factory = register(bt, ET.fromstring(text), [], SUCCEED)

    factory.register_behavior_tree_from_text(text)

    ids = [name + ("-Tree" if name in REGISTRY.names() else "") for name in trees]
    assert sorted(factory.registered_behavior_trees()) == sorted(ids)


@pytest.mark.parametrize("outcome", [SUCCEED, FAIL])
@pytest.mark.parametrize("name", LIBRARY.names_of_trees())
def test_every_tree_ticks_its_leaves_in_the_order_of_ours(name, outcome, bt):
    trees = read_sound_trees(name, LIBRARY, REGISTRY)
    root = ET.fromstring(render_trees(list(trees.values()), dict(iter_leaf_models(REGISTRY))))
    of_version_4 = {"num_attempts", "num_cycles"}
    for element in (each for tree in root.iter("BehaviorTree") for each in tree.iter() if each.tag != "SubTree"):
        for port in element.attrib.keys() - {"ID", "name", *of_version_4}:
            del element.attrib[port]
    ticked, expected = [], []
    factory = register(bt, root, ticked, outcome)
    factory.register_behavior_tree_from_text(ET.tostring(root, encoding="unicode"))

    status = factory.create_tree(root.get("main_tree_to_execute")).tick_while_running()

    succeeds = follow(trees[name].root, trees, outcome, expected)
    assert ticked == expected
    assert status == (bt.NodeStatus.SUCCESS if succeeds else bt.NodeStatus.FAILURE)


def test_a_tree_with_an_unknown_node_is_refused_so_that_the_others_mean_something(bt):
    trees = read_sound_trees("pick", LIBRARY, REGISTRY)
    text = render_trees(list(trees.values()), dict(iter_leaf_models(REGISTRY))).replace("<close_gripper ", "<close_it ")
    factory = register(bt, ET.fromstring(text), [], SUCCEED)

    with pytest.raises(RuntimeError, match="Node not recognized: close_it"):
        factory.register_behavior_tree_from_text(text)
