"""Trees as XML of BehaviorTree.CPP 4: whatever ships comes back as it was, and another parser sees the same tree."""

import types
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from py_trees.behaviour import Behaviour
from py_trees.blackboard import Blackboard
from py_trees.composites import Composite
from py_trees.decorators import Decorator
from py_trees.parsers.behaviour_tree_xml import parse_behaviour_tree_xml
from py_trees.ports import PortInformation, PortsMixin

from phyagentos.errors import DefinitionError
from phyagentos.export.bt_xml import FORMS, NodeModel, Port, decode, encode, render_trees
from phyagentos.export.bt_xml_reader import read_trees
from phyagentos.operations.behaviour_trees import find_tree, iter_leaf_models
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.trees import NodeKind, Reference, iter_nodes, parse_tree, read_tree
from phyagentos.protocol.documents.schema import parse_yaml
from phyagentos.runtime.execution.leaf_registry import build_registry
from phyagentos.runtime.execution.port_types import PORT_TYPES

LIBRARY = Library.open()
REGISTRY = build_registry(LIBRARY)
TREES = LIBRARY.names_of_trees()

EVERY_KIND = """
tree: every_kind
description: 'Every kind of node, and values that are easily taken for others: "{x}" & <y>.'
inputs:
  object: {type: entity, description: What it is about., optional: true}
  things: {type: entities}
  speed: {type: number, default: 0.5, description: "In two\n  lines,\n"}
  word: {type: string, default: "1"}
  near: {type: boolean, default: false}
outputs:
  position: {type: point, description: Where it is.}
root:
  reactive_fallback:
    name: all
    children:
      - condition: at(${object}, (0.1, 0.2, 0.0), 0.03)
      - condition: not holding(target, ${object})
      - reactive_sequence:
          children:
            - parallel: {policy: one, children: [open_gripper, open_gripper, {open_gripper: {name: again}}]}
            - parallel: {children: [{locate: {object: red_cube}}]}
            - retry: {attempts: 3, child: {invert: {child: {locate: {object: "1", position: $position}}}}}
            - repeat: {name: twice, times: 2, child: {fallback: {children: [{sequence: {children: [close_gripper]}}]}}}
            - timeout: {seconds: 1.25, child: {cooldown: {seconds: 4, child: open_gripper}}}
            - for_each: {each: $one, in: $things, child: {locate: {object: $one}}}
            - for_each: {each: $two, in: [red_cube, "true"], child: {locate: {object: $two}}}
            - strange_leaf: {a: true, b: "true", c: [1, 2.5], d: "${object}", e: "{x}", f: "a $(x)", g: '"', i: ""}
            - call: {action: /go, goal: {ways: [{x: 1}, {x: "${speed}"}], to: "${object}"}, result: {n: "${n}"}}
            - subtree: {tree: home}
            - subtree: {tree: free_hand, name: free, with: {object: '${object}'}}
            - subtree: {tree: free_hand, with: {object: blue_cube}}
"""


def find_trees(*roots):
    """The trees and all that they name, by name."""
    trees = {tree.header.tree: tree for tree in roots}
    waiting = list(roots)
    while waiting:
        for node in iter_nodes(waiting.pop().root):
            if node.kind is NodeKind.SUBTREE and node.type not in trees:
                trees[node.type] = read_tree(LIBRARY.get_tree(node.type))
                waiting.append(trees[node.type])
    return trees


def write(trees, path):
    path.write_text(render_trees(list(trees.values()), {}), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def every_kind():
    tree, problems = parse_tree(parse_yaml(EVERY_KIND, "every_kind.yaml"))
    assert problems == ()
    assert {node.kind for node in iter_nodes(tree.root)} == set(NodeKind)
    return tree


def assert_same(trees, path):
    read, problems = read_trees(path)
    assert problems == ()
    assert [located.data["tree"] for located in read] == list(trees)
    for located in read:
        tree, problems = parse_tree(located)
        assert problems == ()
        authored = trees[tree.header.tree]
        assert tree.header.model_dump(exclude={"root"}) == authored.header.model_dump(exclude={"root"})
        assert tree.root == authored.root


@pytest.mark.parametrize("name", TREES)
def test_a_tree_that_ships_comes_back_as_it_was_authored_with_all_its_subtrees(name, tmp_path):
    trees = find_trees(read_tree(LIBRARY.get_tree(name)))

    assert_same(trees, write(trees, tmp_path / "tree.xml"))


def test_every_kind_of_node_and_every_form_of_value_comes_back(every_kind, tmp_path):
    trees = find_trees(every_kind)

    assert_same(trees, write(trees, tmp_path / "tree.xml"))


REFERENCES = st.builds(Reference, st.from_regex(r"[a-z][a-z0-9_]*", fullmatch=True))
WORDS = st.text() | st.from_regex(r"\$?[\"{$(]*[a-z]*[\"})]*", fullmatch=True)
DATA = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | WORDS, st.lists, max_leaves=5
)


@pytest.mark.slow
@given(DATA | REFERENCES)
def test_a_value_is_read_as_it_was_written_and_no_text_holds_a_stray_brace(value):
    text = encode(value)

    assert decode(text) == value
    assert type(decode(text)) is type(value)
    assert isinstance(value, Reference) or not set(text) & set("{}")


def test_a_tree_is_told_apart_from_a_leaf_of_its_name_and_no_port_of_a_subtree_is_left_unwired(every_kind):
    leaf = NodeModel("Action", {"to": Port(type="point")})
    tree = read_tree(LIBRARY.get_tree("drive_to"))
    inner = replace(every_kind, header=every_kind.header.model_copy(update={"tree": "of/mine"}))

    root = ET.fromstring(render_trees(list(find_trees(tree, inner).values()), {"drive_to": leaf}))

    assert {"drive_to-Tree", "of-mine", "home"} <= {each.get("ID") for each in root.iter("BehaviorTree")}
    models = {(each.get("ID"), each.tag): each for each in root.find("TreeNodesModel")}
    assert ("drive_to", "Action") in models
    unwired = 0
    for tree in root.iter("BehaviorTree"):
        keys = []
        for each in tree.iter("SubTree"):
            for port in (port for port in models[each.get("ID"), "SubTree"] if port.tag.endswith("_port")):
                assert port.get("name") in each.attrib or port.get("default") is not None
                keys += [key for key in [each.get(port.get("name"), "")] if key.startswith("{_unwired_")]
        assert len(set(keys)) == len(keys)
        unwired += len(keys)
    assert unwired > 0


# Read by py_trees: classes for what it does not know are made of the file's own model.

EVENT = PortInformation(data_type=str, required=False)
OF_VERSION_4 = {  # nodes that BehaviorTree.CPP has, and py_trees calls otherwise or not at all
    "ReactiveSequence": ("Control", ()),
    "ReactiveFallback": ("Control", ()),
    "RetryUntilSuccessful": ("Decorator", ("num_attempts",)),
    "Repeat": ("Decorator", ("num_cycles",)),
}
BASES = {"Control": Composite, "Decorator": Decorator, "Action": Behaviour, "Condition": Behaviour}


def make_class(kind, inputs, outputs=()):
    def init(self, name, behaviour_class_name, child=None, children=()):
        given = {"child": child} if kind == "Decorator" else {"children": children} if kind == "Control" else {}
        super(cls, self).__init__(name=name, behaviour_class_name=behaviour_class_name, **given)

    body = {
        "INPUT_PORTS": dict.fromkeys(inputs, EVENT),
        "OUTPUT_PORTS": dict.fromkeys(outputs, EVENT),
        "__init__": init,
        "update": lambda self: self.status,
    }
    cls = types.new_class("Declared", (PortsMixin, BASES[kind]), {"register": False}, lambda space: space.update(body))
    return cls


def read_with_py_trees(path, leaves):
    root = ET.parse(path).getroot()
    nodes = {tag: make_class(kind, ports) for tag, (kind, ports) in OF_VERSION_4.items()}
    for model in root.find("TreeNodesModel"):
        if model.tag != "SubTree":
            ports = {each: [port.get("name") for port in model.iter(each)] for each in ("input_port", "output_port")}
            nodes[model.get("ID")] = make_class(model.tag, ports["input_port"], ports["output_port"])
    return parse_behaviour_tree_xml(str(path), node_registry=nodes | leaves)


class Scope(dict):
    """Key of a tree -> a name for it; py_trees gives two instances the same keys where they have the same name."""

    def __init__(self, place=(), wired=()):
        super().__init__(wired)
        self.place = place

    def __missing__(self, key):
        return (*self.place, key)


def expand(node, trees, scope, above=()):
    """Every node below, subtrees opened: its path, its tag, and what each port is wired to."""
    path = (*above, node.name)
    wired = {
        port: scope[value.key] if isinstance(value, Reference) else encode(value) for port, value in node.wiring.items()
    }
    if node.kind is NodeKind.SUBTREE:
        yield from expand(trees[node.type].root, trees, Scope((*scope.place, node.name), wired), path)
        return
    tag = FORMS[node.kind].tag if node.kind in FORMS else node.type
    yield ".".join(path), tag, wired
    for child in node.children:
        yield from expand(child, trees, scope, path)


@pytest.mark.slow
@pytest.mark.parametrize("name", TREES)
def test_py_trees_reads_the_same_nodes_in_the_same_places_with_the_same_keys(name, tmp_path):
    trees = find_trees(read_tree(LIBRARY.get_tree(name)))
    path = tmp_path / "tree.xml"
    path.write_text(render_trees(list(trees.values()), dict(iter_leaf_models(REGISTRY))), "utf-8")

    try:
        root = read_with_py_trees(path, {})
        expected = sorted(expand(trees[name].root, trees, Scope()))
        found = sorted(root.iterate(), key=lambda node: node.name)
        own = {"Selector": "Fallback"}

        assert [node.name for node in found] == [path for path, _, _ in expected]
        tags = [getattr(node, "behaviour_class_name", type(node).__name__) for node in found]
        assert [own.get(tag, tag) for tag in tags] == [tag for _, tag, _ in expected]
        keys = {}
        for node, (_, _, wired) in zip(found, expected, strict=True):
            for port, key in wired.items():
                if isinstance(key, str):
                    assert node.get_input(port) == key
                else:
                    assert keys.setdefault(key, node._get_blackboard_key(port)) == node._get_blackboard_key(port)
        assert len(set(keys.values())) == len(keys)
    finally:
        Blackboard.clear()
        Blackboard.clients.clear()


# What others drew, and what cannot be read.

FOREIGN = """<?xml version="1.0"?>
<root BTCPP_format="4" main_tree_to_execute="MainTree">
  <BehaviorTree ID="MainTree">
    <Sequence>
      <OpenGripper/>
      <Action ID="MoveTo" goal="{goal}" other="{Goal}"/>
      <Timeout msec="soon"><close_gripper/></Timeout>
      <locate objekt="red_cube"/>
      <Inverter/>
      <close_gripper><home/></close_gripper>
      <SubTree ID="home" _autoremap="true"/>
      <condition name="is near" predicate="near it"/>
      <wait seconds="soon"/>
    </Sequence>
  </BehaviorTree>
</root>
"""


def test_a_foreign_tree_is_refused_with_line_and_column_what_is_possible_and_the_nearest_name(paos, tmp_path):
    file = tmp_path / "foreign.xml"
    file.write_text(FOREIGN)

    result = paos("import", file)

    assert result.code == 2
    assert result.out == ""
    for place, *parts in (
        (
            "5:7: UNKNOWN_NAME (leaf): found 'OpenGripper'",
            "expected attach, call, close_gripper,",
            "Did you mean 'open_gripper'? Write what none of them does in the behaviours.py of a skill.",
        ),
        ("6:7: UNKNOWN_NAME (leaf): found 'MoveTo'", "Did you mean 'move_to'?"),
        ("6:7: INVALID_VALUE: found other='{Goal}'", "keys are small letters", "Write other='{goal}'."),
        ("7:7: INVALID_VALUE: found <Timeout msec='soon'>", "expected a number of milliseconds"),
        ("8:7: UNKNOWN_NAME (port): found 'objekt'", "Did you mean 'object'?"),
        ("9:7: INVALID_VALUE: found <Inverter> with 0 nodes in it", "expected one"),
        ("10:7: INVALID_VALUE: found <close_gripper> with 1 nodes in it", "expected none; they are held by Fallback,"),
        ("11:7: INVALID_VALUE: found _autoremap='true'", "expected each port wired", "Write port='{key}' for each."),
        ("12:7: INVALID_VALUE: found a condition with {'name': 'is near'", "no name of its own"),
        ("12:7: SYNTAX:",),
        ("13:7: INVALID_VALUE: found 'soon'", "type number"),
    ):
        (line,) = [line for line in result.err.splitlines() if line.startswith(f"{file}:{place}")]
        assert all(part in line for part in parts), line


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (
            "<root BTCPP_format='4'>\n <a></b></root>",
            ":2:7: SYNTAX: found an end tag that is not of the element open last; expected well-formed XML",
        ),
        ("<!DOCTYPE a [<!ENTITY x 'y'>]><root/>", ":1:13: SYNTAX: found a DOCTYPE;"),
        ("<a>" * 300, ":1:601: SYNTAX: found more than 200 levels"),
        ("", ":1:1: SYNTAX: found an end of the file before every element is closed, or nothing;"),
        (
            "<root><BehaviorTree ID='a'><wait/></BehaviorTree></root>",
            ":1:1: INVALID_VALUE: found <root> of format 3 or",
        ),
        (
            "<root BTCPP_format='4'><include path='a.xml'/></root>",
            ':1:24: INVALID_VALUE: found <include path="a.xml">;',
        ),
        ("<root BTCPP_format='4'/>", ":1:1: INVALID_VALUE: found no tree; expected <BehaviorTree>"),
        (
            "<root BTCPP_format='4'><BehaviorTree ID='a'/><BehaviorTree ID='a'/></root>",
            ":1:46: INVALID_VALUE: found <BehaviorTree ID='a'>; expected each <BehaviorTree> once",
        ),
        (
            "<root BTCPP_format='4'><BehaviorTree ID='MyTree'/>\n<BehaviorTree ID='my tree'/></root>",
            ":2:1: INVALID_VALUE: found <BehaviorTree ID='my tree'>; expected each <BehaviorTree> once, and",
        ),
        (
            "<root BTCPP_format='4'><BehaviorTree ID='a'><wait/></BehaviorTree><TreeNodesModel><SubTree ID='a'>"
            "\n<input_port name='b' type='number' default='{c}'/></SubTree></TreeNodesModel></root>",
            ":2:1: INVALID_VALUE: found default='{c}'; expected a value. Write it, or wire the port where",
        ),
        ("<root BTCPP_format='4'><BehaviorTree ID='a'/></root>", ":1:24: INVALID_VALUE: found 0 nodes in a tree;"),
        (
            "<root BTCPP_format='4'><BehaviorTree ID='a'><wait/></BehaviorTree><TreeNodesModel><SubTree ID='a'>"
            "\n<inout_port name='b'/></SubTree></TreeNodesModel></root>",
            ":2:1: INVALID_VALUE: found <inout_port>; expected <input_port> or <output_port>. Write an input",
        ),
        (
            "<root BTCPP_format='4'><BehaviorTree ID='a'><wait/></BehaviorTree><TreeNodesModel><SubTree ID='a'>"
            "\n<input_port name='b' type='std::string'/></SubTree></TreeNodesModel></root>",
            ":2:1: INVALID_VALUE: found 'std::string'; expected 'entity', 'entities',",
        ),
    ],
)
def test_what_is_no_tree_is_refused_at_its_place(text, line, paos, tmp_path):
    file = tmp_path / "broken.xml"
    file.write_text(text)

    result = paos("import", file)

    assert result.code == 2
    assert any(each.startswith(f"{file}{line}") for each in result.err.splitlines()), result.err


def import_root(paos, tmp_path, nodes):
    file = tmp_path / "drawn.xml"
    file.write_text(f'<root BTCPP_format="4"><BehaviorTree ID="drawn">\n{nodes}\n</BehaviorTree></root>')
    return paos("import", file, "--to", tmp_path)


@pytest.mark.parametrize(
    ("nodes", "root"),
    [
        ('<Sleep msec="1500"/>', {"wait": {"seconds": 1.5}}),
        ('<Timeout msec="5000"><move_home/></Timeout>', {"timeout": {"seconds": 5.0, "child": "move_home"}}),
        ('<Delay delay_msec="500"><move_home/></Delay>',
         {"sequence": {"children": [{"wait": {"seconds": 0.5}}, "move_home"]}}),
        ("<ForceSuccess><move_home/></ForceSuccess>",
         {"fallback": {"children": ["move_home", {"wait": {"seconds": 0}}]}}),
        ('<Decorator ID="ForceFailure"><move_home/></Decorator>',
         {"sequence": {"children": ["move_home", {"fail": {"code": "UNMET"}}]}}),
        ("<AlwaysSuccess/>", {"wait": {"seconds": 0}}),
        ('<AlwaysFailure name="no"/>', {"fail": {"code": "UNMET", "name": "no"}}),
        ('<RetryUntilSuccesful num_attempts="2"><move_home/></RetryUntilSuccesful>',
         {"retry": {"attempts": 2, "child": "move_home"}}),
        ('<Parallel success_count="-1"><move_home/></Parallel>',
         {"parallel": {"policy": "all", "children": ["move_home"]}}),
        ('<Parallel success_count="1" failure_count="1"><move_home/><open_gripper/></Parallel>',
         {"parallel": {"policy": "one", "children": ["move_home", "open_gripper"]}}),
    ],
)  # fmt: skip
def test_a_node_of_others_that_has_an_equal_here_is_imported(nodes, root, paos, tmp_path):
    result = import_root(paos, tmp_path, nodes)
    assert (result.code, result.err) == (0, "")
    assert parse_yaml((tmp_path / "trees" / "drawn.yaml").read_text(), "").data["root"] == root


@pytest.mark.parametrize(
    ("nodes", "lines"),
    [
        ('<RateController hz="1"><Sequence><ReplanPath/><wait seconds="1" posture="x"/></Sequence></RateController>',
         ["2:1: UNKNOWN_NAME (control): found <RateController>", "2:34: UNKNOWN_NAME (leaf): found 'ReplanPath'",
          "2:47: UNKNOWN_NAME (port): found 'posture'"]),
        ("<Ours><Theirs><wait/></Theirs><wait/></Ours>",
         ["2:1: UNKNOWN_NAME (control): found <Ours>", "2:7: UNKNOWN_NAME (control): found <Theirs>",
          "2:15: MISSING_VALUE", "2:31: MISSING_VALUE"]),
        ('<Script code="x := 1"/>', ["2:1: UNKNOWN_NAME (control): found <Script>; expected"]),
        ('<Parallel success_count="2"><move_home/><move_home/><move_home/></Parallel>',
         ["2:1: INVALID_VALUE: found <Parallel success_count=\"2\">; expected all or 1 to succeed"]),
        ('<wait seconds="1" _skipIf="x == 1"/>', ["2:1: INVALID_VALUE: found _skipIf='x == 1'"]),
        ("<ForceSuccess/>", ["2:1: INVALID_VALUE: found <ForceSuccess> with 0 nodes in it; expected one"]),
        ('<LoopPose queue="{a}"><open_gripper/></LoopPose>',
         ["2:1: UNKNOWN_NAME (control): found <LoopPose>; expected Fallback, Inverter, ReactiveFallback, "
          "ReactiveSequence, Repeat, RetryUntilSuccessful, Sequence, cooldown, for_each, parallel, timeout. "
          "Write <for_each>"]),
        ('<Sequence><SubTree ID="Not-Here"/><SubTree ID="home" speed="1"/></Sequence>',
         ["2:11: UNKNOWN_NAME (tree): found 'not_here'", "2:35: UNKNOWN_NAME (port): found 'speed'; expected (none). "
          "Declare it as an input or output of 'home'."]),
        ('<wait seconds="NaN"/>', ["2:1: INVALID_VALUE: found .nan; expected a finite number"]),
        ('<wait name="a/b" seconds="1"/>', ["2:1: INVALID_VALUE: found 'a/b'; expected a name of one line"]),
    ],
)  # fmt: skip
def test_every_problem_below_a_node_of_others_is_told_in_one_run_in_the_order_of_the_file(nodes, lines, paos, tmp_path):
    result = import_root(paos, tmp_path, nodes)
    assert result.code == 2
    told = [line for line in result.err.splitlines() if line.startswith(f"{tmp_path}/drawn.xml:")]
    assert len(told) == len(lines), result.err
    for line, wanted in zip(told, lines, strict=True):
        assert line.startswith(f"{tmp_path}/drawn.xml:{wanted}"), line
    assert not list(tmp_path.glob("trees/*"))


def test_trees_of_others_get_names_of_this_project_and_so_do_the_nodes_that_mean_them(paos, tmp_path):
    file = tmp_path / "others.xml"
    file.write_text(
        """<root BTCPP_format="4"><BehaviorTree ID="MainTree"><Sequence>
          <SubTree ID="Re-Zero / Sensors" _external="false"/><wait seconds="1" _skipIf="false"/>
        </Sequence></BehaviorTree><BehaviorTree ID="Re-Zero / Sensors"><open_gripper/></BehaviorTree></root>"""
    )
    assert paos("import", file, "--to", tmp_path).code == 0
    again = file.read_text().replace("MainTree", "Other").partition('<BehaviorTree ID="Re')[0] + "</root>"
    file.write_text(again)  # whose subtree was imported before

    assert paos("import", file, "--to", tmp_path).code == 0
    assert (tmp_path / "trees" / "other.yaml").read_text() == (
        "tree: other\ndescription: Imported from others.xml, there 'Other'.\nroot:\n  sequence:\n    children:\n"
        "    - subtree: {tree: re_zero_sensors}\n    - wait: {seconds: 1}\n"
    )


def test_a_subtree_that_cannot_be_read_is_no_tree_to_choose(paos, tmp_path):
    file = tmp_path / "others.xml"
    file.write_text(
        """<root BTCPP_format="4"><BehaviorTree ID="a"><SubTree ID="b"/></BehaviorTree><BehaviorTree ID="b"><wait/>
        </BehaviorTree><TreeNodesModel><SubTree ID="b"><input_port name="c"/></SubTree></TreeNodesModel></root>"""
    )
    result = paos("import", file)
    assert "1:45: BROKEN_TREE: found 'b', which cannot be read; expected a sound tree. Mend 'b' first." in result.err


def test_a_tree_drawn_with_explicit_tags_and_short_keys_becomes_yaml(paos, tmp_path):
    file = tmp_path / "drawn.xml"
    file.write_text(
        """<root BTCPP_format="4"><BehaviorTree ID="show" _description="Show a thing.">
          <Sequence name="show">
            <Action ID="locate" object="{=}" _uid="3"/>
            <condition predicate="visible(${object})"/>
            <SubTree ID="home" _autoremap="false"/>
          </Sequence>
        </BehaviorTree><TreeNodesModel><SubTree ID="show"><input_port name="object" type="entity">It.</input_port>
        </SubTree></TreeNodesModel></root>"""
    )

    result = paos("import", file, "--to", tmp_path)

    assert (result.code, result.err, result.out) == (0, "", f"{tmp_path}/trees/show.yaml\n")
    assert (tmp_path / "trees" / "show.yaml").read_text() == (
        "tree: show\ndescription: Show a thing.\ninputs:\n  object: {type: entity, description: It.}\nroot:\n"
        "  sequence:\n    children:\n    - locate: {object: '${object}'}\n    - {condition: 'visible(${object})'}\n"
        "    - subtree: {tree: home}\n"
    )


@pytest.mark.slow
def test_export_and_import_by_command_write_what_is_new_and_never_over_another_tree(paos, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("tree.xml").write_text(paos("export", "bt-xml", "pick_and_place").out)

    again = paos("import", "tree.xml", "--to", "project")
    assert (again.code, again.out) == (0, "every tree of the file is in the library already\n")
    Path("tree.xml").write_text(Path("tree.xml").read_text().replace('speed="0.6"', 'speed="0.7"'))
    changed = paos("import", "tree.xml", "--to", "project")
    assert (changed.code, changed.out) == (0, "project/trees/pick.yaml\n")
    assert paos("lint", "project/trees/pick.yaml").code == 0
    assert "speed: 0.7" in Path("project/trees/pick.yaml").read_text()
    Path("tree.xml").write_text(Path("tree.xml").read_text().replace('speed="0.7"', 'speed="0.8"'))
    refused = paos("import", "tree.xml", "--to", "project")
    assert refused.code == 2
    assert refused.err.startswith("project/trees/pick.yaml: WOULD_OVERWRITE: found another tree;")
    mine = paos("export", "bt-xml", "project/trees/pick.yaml")
    assert 'speed="0.7"' in mine.out
    unknown = paos("export", "bt-xml", "pik")
    assert (unknown.code, "Did you mean 'pick'?" in unknown.err) == (2, True)


@pytest.mark.parametrize("name", LIBRARY.names_of_skills())
def test_a_skill_is_exported_as_its_tree(name):
    assert find_tree(name, LIBRARY) in TREES


@pytest.mark.parametrize("name", REGISTRY.names())
def test_the_model_of_a_leaf_has_its_ports_with_their_ways_types_and_defaults(name):
    leaf = REGISTRY.get(name)
    model = dict(iter_leaf_models(REGISTRY))[name]

    ways = {port: each.direction for port, each in model.ports.items()}
    assert ways == dict.fromkeys(leaf.INPUT_PORTS, "input_port") | dict.fromkeys(leaf.OUTPUT_PORTS, "output_port")
    for port, declared in {**leaf.INPUT_PORTS, **leaf.OUTPUT_PORTS}.items():
        assert PORT_TYPES.get(model.ports[port].type, dict) is declared.data_type
        assert model.ports[port].default == (declared.default_value if declared.has_default else None)
        assert model.ports[port].description == declared.description
    assert model.description
    assert model.kind == ("Condition" if name in {"fail", "is_sharp", "verify_grasp"} else "Action")


@pytest.mark.parametrize("options", [(), ("--run-python",)])
def test_a_tree_with_leaves_of_a_skills_own_python_comes_back_whether_that_is_executed_or_not(options, paos, tmp_path):
    project = Path(__file__).parents[2] / "examples" / "projects" / "06_gymnasium"
    file = tmp_path / "tree.xml"
    file.write_text(paos("export", "bt-xml", project / "trees" / "close_along_line.yaml", *options).out)

    again = paos("import", file, "--to", project, *options)

    assert (again.code, again.out) == (0, "every tree of the file is in the library already\n"), again.err
    assert ('<Action ID="move_beside">' in file.read_text()) is bool(options)


def test_a_file_of_countless_trees_is_refused_at_once(tmp_path):
    trees = "".join(f'<BehaviorTree ID="t{each}"><AlwaysSuccess/></BehaviorTree>' for each in range(501))
    (tmp_path / "many.xml").write_text(f'<root BTCPP_format="4">{trees}</root>')
    (problem,) = read_trees(tmp_path / "many.xml")[1]
    assert "found 501 trees; expected at most 500 in one file" in str(problem)


def test_a_file_of_countless_elements_is_refused_at_once(tmp_path):
    path, inside = tmp_path / "wide.xml", "<Foo/>" * 100_000
    path.write_text(f'<root BTCPP_format="4"><BehaviorTree ID="a"><Sequence>{inside}</Sequence></BehaviorTree></root>')
    with pytest.raises(DefinitionError, match="more than 20000 elements"):
        read_trees(path)
