"""Parameters and sub-graphs: what a file composes to, and every slip at its place in its own file."""

import re
import string
from textwrap import dedent

import networkx as nx
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from phyagentos.agent.goals import composition
from phyagentos.agent.goals.graph import check_goal_graph, read_goal_graph
from phyagentos.errors import DefinitionError

PART = """
    goal: part
    objective: ${thing} into ${tray}, with a look before.
    scene: table
    parameters:
      thing: {type: entity, kinds: [cube], default: red_cube}
      tray: {type: place, default: red_tray}
      speed: {type: number, default: 0.5, minimum: 0.1, maximum: 1.0}
      limit_s: {type: number, default: 20}
    targets: {arm: any}
    constraints: ["upright(bottle)"]
    defaults: {timeout_s: "${limit_s}", queue_s: 9}
    sessions:
      carry:
        skill: pick_and_place
        target: arm
        with: {object: "${thing}", destination: "${tray}", speed: "${speed}"}
        hold: ["exists(${object})"]
      beside:
        after: [carry]
        skill: pick_and_place
        target: arm
        with: {object: yellow_cube, destination: "${tray}", near: "${carry.outputs.place_site}"}
    accept: ["inside(${thing}, ${tray})"]
    """
WHOLE = """
    goal: whole
    objective: Two parts and a look.
    scene: table
    targets: {arm: panda}
    sessions:
      first: {include: part}
      then:
        include: part
        after: [first]
        with: {thing: green_cube, tray: green_tray}
      last:
        after: [then, first-carry]
        skill: pick_and_place
        with: {object: blue_cube, destination: red_tray, near: "${then-beside.outputs.place_site}"}
    accept: ["inside(blue_cube, red_tray)"]
    """


@pytest.fixture
def whole(write_graph):
    def write(part=PART, text=WHOLE):
        write_graph(part, "part.yaml")
        return write_graph(text)

    return write


def test_an_include_becomes_its_nodes_with_longer_names(whole, catalogue):
    graph = read_goal_graph(whole(), catalogue)
    assert {name: node.after for name, node in graph.nodes.items()} == {
        "first-carry": (),
        "first-beside": ("first-carry",),
        "then-carry": ("first-carry", "first-beside"),
        "then-beside": ("then-carry",),
        "last": ("then-carry", "then-beside", "first-carry"),
    }
    carry = graph.nodes["then-carry"].spec
    assert carry.arguments == {"object": "green_cube", "destination": "green_tray", "speed": 0.5}
    assert carry.hold == ("exists(${object})", "upright(bottle)")  # constraints hold all through its own nodes only
    assert (carry.timeout_s, graph.spec.defaults.queue_s, graph.spec.constraints) == (20, 3600.0, ())
    assert graph.choices["then-carry"].target == "panda"  # the including graph binds the role
    assert graph.nodes["then-beside"].data[0].node == "then-carry"
    assert graph.spec.accept == (
        "inside(blue_cube, red_tray)",
        "inside(red_cube, red_tray)",
        "inside(green_cube, green_tray)",
    )


def test_an_include_states_its_own_acceptance_and_passes_outputs_and_edges_on(whole, catalogue):
    text = WHOLE.replace(
        "        include: part\n        after: [first]\n",
        "        include: part\n        after: [first, {node: first-beside, on: failure}]\n        accept: []\n",
    )
    part = PART.replace("limit_s: {type", "where: {type: point, default: [0.5, 0, 0]}\n      limit_s: {type")
    part = part.replace("yellow_cube, destination", 'yellow_cube, near: "${where}", destination', 1)
    part = part.replace(', near: "${carry.outputs.place_site}"', "")
    text = text.replace("tray: green_tray}", 'tray: green_tray, where: "${first-carry.outputs.place_site}"}')
    text = text.replace("after: [first, ", "after: [first-carry, ")
    graph = read_goal_graph(whole(part, text), catalogue)
    assert graph.nodes["then-carry"].after == ("first-carry",)
    assert graph.nodes["then-carry"].on_failure == graph.nodes["then-beside"].on_failure == (("first-beside",),)
    assert graph.nodes["then-beside"].data[0].node == "first-carry"  # of the including graph, which has no `carry`
    assert graph.spec.accept == ("inside(blue_cube, red_tray)", "inside(red_cube, red_tray)")


def test_the_bundle_needs_no_other_file_and_is_the_same_graph(whole, catalogue, tmp_path):
    graph = read_goal_graph(whole(), catalogue, {"targets.arm": "panda"})
    (tmp_path / "part.yaml").unlink()
    (tmp_path / "bundle.yaml").write_text(yaml.safe_dump(graph.bundle, sort_keys=False))
    again = read_goal_graph(tmp_path / "bundle.yaml", catalogue)
    assert (again.spec, dict(again.nodes), again.bundle) == (graph.spec, dict(graph.nodes), None)


def test_a_parameter_is_given_by_its_name_and_a_role_by_its_place(whole, catalogue, tmp_path):
    whole()
    given = {"parameters.thing.default": "blue_cube", "parameters.limit_s.default": "7", "targets.arm": "panda"}
    graph = read_goal_graph(tmp_path / "part.yaml", catalogue, given)
    assert graph.choices["carry"].parameters["object"] == "blue_cube"
    assert (graph.spec.defaults.timeout_s, graph.spec.accept) == (7.0, ("inside(blue_cube, red_tray)",))
    assert graph.spec.objective == "blue_cube into red_tray, with a look before."
    assert graph.bundle["parameters"]["thing"]["default"] == "blue_cube"


def test_a_parameter_does_not_reach_below_a_variable_or_an_argument_of_its_name(write_graph, catalogue):
    text = """
    goal: shadow
    objective: Names.
    scene: table
    parameters: {object: {type: entity, default: red_cube}, cube: {type: entity, default: red_cube}}
    sessions:
      each:
        foreach: {cube: [blue_cube, green_cube]}
        skill: pick
        with: {object: "${cube}"}
        accept: ["visible(${object})", "visible(${cube})"]
    """
    graph = read_goal_graph(write_graph(text), catalogue)
    assert list(graph.nodes) == ["each-blue_cube", "each-green_cube"]
    assert graph.nodes["each-blue_cube"].spec.accept == ("visible(${object})", "visible(blue_cube)")


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (
            {"thing": "bottle"},
            r"^--set thing:1:1: INVALID_VALUE: found 'bottle', of kind bottle; expected of kind cube",
        ),
        (
            {"thing": "red_cub"},
            r"^--set thing:1:1: UNKNOWN_NAME \(object\): found 'red_cub'.*Did you mean 'red_cube'\?",
        ),
        ({"speed": "7"}, r"^--set speed:1:1: INVALID_VALUE: found 7; expected at most 1.0"),
        ({"speed": "fast"}, r"^--set speed:1:1: INVALID_VALUE: found 'fast'; expected number"),
        (
            {"sped": "0.5"},
            r"^--set sped: UNKNOWN_NAME \(parameter\): found 'sped'; .*targets.arm.*Did you mean 'speed'\?",
        ),
        ({"thing": "["}, r"^--set thing:\d+:\d+: SYNTAX"),
    ],
)
def test_a_bad_value_is_told_once_where_it_was_given(whole, catalogue, tmp_path, overrides, told):
    whole()
    with pytest.raises(DefinitionError) as caught:
        read_goal_graph(
            tmp_path / "part.yaml", catalogue, {f"parameters.{key}.default": text for key, text in overrides.items()}
        )
    (problem,) = caught.value.problems
    assert re.search(told, str(problem)), problem


def _line(text, words):
    """`line:column` of some words, or of what stands in front of a bar in them."""
    before, _, after = words.rpartition("|")
    lines = dedent(text).lstrip("\n").split("\n")
    number, line = next((i, each) for i, each in enumerate(lines, 1) if before + after in each)
    return f"{number}:{line.index(before + after) + len(before) + 1}"


@pytest.mark.parametrize(
    ("file", "old", "new", "at", "told"),
    [
        ("part", "skill: pick_and_place", "skill: pick_and_plaze", "|skill: pick_and_plaze", r"UNKNOWN_NAME \(skill\)"),
        ("part", "tray: {type: place, default", "tray: {type: plac, default", "tray: {|type: plac", "INVALID_VALUE"),
        (
            "part",
            "default: red_tray",
            "default: red_tary",
            "|default: red_tary",
            r"UNKNOWN_NAME \(object\).*'red_tray'",
        ),
        ("part", ", default: red_tray", "", "|tray: {type: place}", "MISSING_VALUE.*'default'"),
        ("part", "after: [carry]", "after: [cary]", "after: [|cary", r"UNKNOWN_NAME \(node\): found 'first-cary'"),
        (
            "part",
            "inside(${thing}",
            "inside(${thin}",
            'accept: [|"inside',
            r"UNKNOWN_NAME \(reference\).*Did you mean 'thing'",
        ),
        ("part", "upright(bottle)", "upright(botle)", 'constraints: [|"upr', r"UNKNOWN_NAME \(object\).*'bottle'"),
        ("part", "scene: table", "scene: tabel", "|scene: tabel", "INVALID_VALUE: found 'tabel'; expected 'table'"),
        ("part", "queue_s: 9", "queue: 9", "|queue: 9", r"UNKNOWN_NAME \(key\).*'queue_s'"),
        ("part", "      carry:", "      Carry:", "|Carry:", "INVALID_VALUE"),
        ("graph", "{include: part}", "{include: prt}", "{|include: prt", r"UNKNOWN_NAME \(file\).*Did you mean 'part'"),
        (
            "graph",
            "{thing: green",
            "{thng: green",
            "{|thng: green",
            r"UNKNOWN_NAME \(parameter\).*Did you mean 'thing'",
        ),
        (
            "graph",
            "{thing: green_cube",
            "{thing: bottle",
            "{|thing: bottle",
            "INVALID_VALUE.*of kind cube",
        ),
        ("graph", "{thing: green_cube", '{thing: "${cub}"', '{|thing: "${cub}"', r"UNKNOWN_NAME \(reference\)"),
        ("graph", "after: [first]", "aftr: [first]", "|aftr: [first]", r"UNKNOWN_NAME \(key\).*Did you mean 'after'"),
        ("graph", "after: [first]", "after: [frst]", "after: [|frst]", r"UNKNOWN_NAME \(node\).*Did you mean 'first'"),
        ("graph", "{include: part}", "{include: graph}", "{|include: graph}", "CYCLE: found graph -> graph"),
    ],
)
def test_each_slip_is_told_at_its_place_in_its_own_file(whole, catalogue, file, old, new, at, told):
    part, text = (PART.replace(old, new, 1), WHOLE) if file == "part" else (PART, WHOLE.replace(old, new, 1))
    problems = [str(each) for each in check_goal_graph(whole(part, text), catalogue)]
    place = _line(part if file == "part" else text, at)
    assert any(re.search(rf"/{file}.yaml:{place}: {told}", each) for each in problems), (place, problems)


def test_files_that_include_each_other_are_refused_and_so_are_too_many(write_graph, catalogue, monkeypatch):
    part = PART.replace("      carry:\n", "      more: {include: graph}\n      carry:\n")
    write_graph(part, "part.yaml")
    problems = [str(each) for each in check_goal_graph(write_graph(WHOLE), catalogue)]
    assert any("CYCLE: found graph -> part -> graph" in each and "part.yaml" in each for each in problems), problems
    twice = WHOLE.replace("        with: {thing: green_cube, tray: green_tray}\n", "")
    monkeypatch.setattr(composition, "INCLUDES_MAX", 8)
    for level in range(4):  # each includes the next one twice
        write_graph(twice.replace("include: part", f"include: level_{level + 1}"), f"level_{level}.yaml")
    write_graph(PART, "level_4.yaml")
    problems = check_goal_graph(write_graph(twice.replace("include: part", "include: level_0")), catalogue)
    assert any("CYCLE: found more than 8 includes" in str(each) for each in problems)


NAMES = st.text(string.ascii_lowercase, min_size=1, max_size=3)
CUBES = ["red_cube", "green_cube", "blue_cube", "yellow_cube"]


@st.composite
def trees(draw, depth=3):
    """A graph as data: nodes wait for earlier ones, an include holds a graph of its own."""
    names = draw(st.lists(NAMES, min_size=1, max_size=3, unique=True))
    sessions = {}
    for index, name in enumerate(names):
        after = draw(st.lists(st.sampled_from(names[:index]), unique=True)) if index else []
        edges = [draw(st.sampled_from([each, {"node": each, "on": "failure"}])) for each in after]
        if depth > 1 and draw(st.booleans()):
            item = draw(st.sampled_from([*CUBES, "${thing}"]))
            sessions[name] = {"include": draw(trees(depth=depth - 1)), "with": {"thing": item}, "after": edges}
        else:
            item = draw(st.sampled_from(["${thing}", *CUBES]))
            sessions[name] = {"skill": "pick", "with": {"object": item}, "after": edges}
    return {
        "goal": "tree",
        "objective": "${thing}",
        "scene": "table",
        "parameters": {"thing": {"type": "entity", "default": draw(st.sampled_from(CUBES))}},
        "sessions": sessions,
        "accept": ["exists(${thing})"],
    }


def expand(tree, item, prefix="", before=(), failed=()):
    """What a tree means, said again: node -> object, whom it waits for, whose failure it waits for."""
    found, groups = {}, {}
    for name, node in tree["sessions"].items():
        value = node["with"].get("thing", node["with"].get("object")).replace("${thing}", item)
        edges = [(each, "success") if isinstance(each, str) else (each["node"], each["on"]) for each in node["after"]]
        after = [set(groups[each]) for each, on in edges if on == "success"] or ([] if edges else list(before))
        lost = [*(frozenset(groups[each]) for each, on in edges if on == "failure"), *failed]
        if "include" in node:
            inner = expand(node["include"], value, f"{prefix}{name}-", after, lost)
        else:
            inner = {f"{prefix}{name}": (value, set().union(*after), set(lost))}
        groups[name] = list(inner)
        found |= inner
    return found


def find_waits(meant):
    """Who waits for whom: also each node, that waits for another, for the branches on the failure of that one."""
    waits = nx.DiGraph()
    for name, (_, after, failed) in meant.items():
        waits.add_edges_from((before, name) for before in (*after, *set().union(*failed)))
        for other, (_, _, lost) in meant.items():
            waits.add_edges_from((other, name) for _ in (after & set().union(*lost)))
    return waits


@pytest.mark.slow
@settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(tree=trees(), item=st.sampled_from(CUBES))
def test_every_tree_expands_to_what_it_means_and_its_bundle_to_the_same(catalogue, tmp_path, tree, item):
    file = tmp_path / "tree.yaml"
    file.write_text(yaml.safe_dump(tree, sort_keys=False))
    meant = expand(tree, item)
    given = {"parameters.thing.default": item}
    if not nx.is_directed_acyclic_graph(find_waits(meant)):
        with pytest.raises(DefinitionError, match="CYCLE"):
            read_goal_graph(file, catalogue, given)
        return
    graph = read_goal_graph(file, catalogue, given)
    assert {
        name: (graph.choices[name].parameters["object"], set(node.after), {frozenset(each) for each in node.on_failure})
        for name, node in graph.nodes.items()
    } == meant
    assert set(graph.order) == set(meant)
    rank = {name: index for index, name in enumerate(graph.order)}
    assert all(rank[before] < rank[name] for name, node in graph.nodes.items() for before in node.predecessors)
    if graph.bundle is not None:
        file.write_text(yaml.safe_dump(graph.bundle, sort_keys=False))
    assert dict(read_goal_graph(file, catalogue).nodes) == dict(graph.nodes)
