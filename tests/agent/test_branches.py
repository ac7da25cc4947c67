"""Branches on failure: what runs, what is left out, and when the goal is met after all."""

import re

import pytest

from phyagentos.agent.goals.graph import check_goal_graph, read_goal_graph, render_mermaid
from phyagentos.agent.goals.spec import NodeSpec
from phyagentos.errors import Problem
from phyagentos.store.views.tasks import render_graph, render_task

from .conftest import check_report, get_order, slip

UNFIT = Problem(code="NOT_OFFERED", address="joint_torque")
GRAPH = """
    goal: branches
    objective: Red into its tray, else blue.
    scene: table
    targets: {arm: panda}
    defaults: {max_replans: 0}
    sessions:
      last:
        after: [main]
        skill: pick_and_place
        with: {object: green_cube, destination: green_tray}
      main:
        skill: pick_and_place
        with: {object: red_cube, destination: red_tray}
      other:
        after: [{node: main, on: failure}]
        skill: pick_and_place
        with: {object: blue_cube, destination: blue_tray}
      behind:
        after: [other]
        skill: pick_and_place
        with: {object: yellow_cube, destination: blue_tray}
    accept: ["count(inside(*, green_tray)) >= 1"]
    """


ONLY_RED = GRAPH.replace("count(inside(*, green_tray)) >= 1", "inside(red_cube, red_tray)")
AFTER_BOTH = GRAPH.replace("after: [main]", "after: [main, other]")
AFTER_TWO = GRAPH.replace("{node: main, on: failure}", "{node: main, on: failure}, {node: last, on: failure}").replace(
    "        after: [main]\n", ""
)
NEAR_OTHER = GRAPH.replace("destination: green_tray}", 'destination: green_tray, near: "${other.outputs.place_site}"}')
NOT_TAKEN = {"last": "done", "main": "done", "other": "skipped", "behind": "skipped"}
RESCUED = {"last": "done", "main": "rescued", "other": "done", "behind": "done"}


@pytest.mark.parametrize(
    ("graph", "stage", "expected", "ran"),
    [
        pytest.param(
            GRAPH,
            {},
            {
                "verdict": "success",
                "nodes": NOT_TAKEN,
                "reasons": {"": "every node on a branch that was taken is done, and the criterion holds"},
            },
            ["main", "last"],
            id="a branch that is not taken is left out with what only waits for it",
        ),
        pytest.param(
            GRAPH,
            {"script": {"main": slip}},
            {"verdict": "success", "exit_code": 0, "nodes": RESCUED},
            ["main", "other", "behind", "last"],
            id="a branch makes up for a node that missed and what waits goes on",
        ),
        pytest.param(
            GRAPH,
            {"refuse": {"main": UNFIT}},
            {"verdict": "success", "exit_code": 0, "nodes": RESCUED},
            ["other", "behind", "last"],
            id="it makes up for a node that was refused",
        ),
        pytest.param(
            GRAPH,
            {"script": {"main": slip, "other": slip}},
            {
                "verdict": "failure",
                "exit_code": 1,
                "nodes": dict.fromkeys(RESCUED, "blocked"),
                "reasons": {"": "node main cannot be done: "},
            },
            ["main", "other"],
            id="a goal fails with its first cause when the branch fails too",
        ),
        pytest.param(
            ONLY_RED,
            {"script": {"main": slip}},
            {"verdict": "failure", "nodes": RESCUED, "reasons": {"": "inside(red_cube, red_tray) is false"}},
            ["main", "other", "behind", "last"],
            id="a goal is not met by a branch alone",
        ),
        pytest.param(
            AFTER_BOTH, {}, {"nodes": NOT_TAKEN}, ["main", "last"], id="what waits for both ways goes on after one"
        ),
        pytest.param(
            AFTER_BOTH,
            {"script": {"main": slip}},
            {"nodes": RESCUED},
            ["main", "other", "behind", "last"],
            id="it goes on after the other one",
        ),
        pytest.param(
            AFTER_TWO,
            {"script": {"main": slip}},
            {"verdict": "failure", "nodes": NOT_TAKEN | {"main": "blocked"}},
            ["last", "main"],
            id="a node behind several failures needs each of them",
        ),
        pytest.param(
            NEAR_OTHER,
            {},
            {"verdict": "failure", "nodes": dict.fromkeys(RESCUED, "skipped") | {"main": "done"}},
            ["main"],
            id="an output of a branch that is not taken is not waited for",
        ),
    ],
)
def test_a_branch_on_failure_runs_where_it_is_needed_and_nowhere_else(
    make_stage, write_graph, graph, stage, expected, ran
):
    stage = make_stage(**stage)
    check_report(stage.pursue(write_graph(graph)), **expected)
    assert get_order(stage) == ran


@pytest.mark.slow
@pytest.mark.parametrize("script", [{}, {"main": slip}], ids=["all well", "main fails"])
def test_an_agent_that_starts_anew_comes_to_the_same_end(make_stage, write_graph, script):
    graph = write_graph(GRAPH)
    whole = make_stage(script).pursue(graph)

    class Dying:
        def on_change(self, goal, ledger):
            stage.runtime.on_change(goal, ledger)
            if ledger.seq > until:
                raise KeyboardInterrupt

    for records in range(3, 36, 6):
        stage, until = make_stage(script), records
        try:
            stage.make_mission(observers=[Dying()]).run(graph, seed=7)
        except KeyboardInterrupt:
            again = stage.make_mission().run(graph, seed=7)
            assert (again.verdict, again.nodes) == (whole.verdict, whole.nodes)


def test_documents_and_drawings_say_which_branch_is_not_taken(make_stage, write_graph, catalogue):
    plan = render_mermaid(read_goal_graph(write_graph(GRAPH), catalogue))
    assert ('n1 -. "on failure" .-> n2' in plan, "n0 --> n1" in plan) == (True, False)
    mission = make_stage().make_mission()
    mission.run(write_graph(GRAPH), seed=7)
    goal = mission.ledger.goals["branches-7"]
    drawing, text = render_graph(goal), render_task(goal, mission.ledger)
    assert '["<b>other</b><br/>skipped"]:::skipped' in drawing
    assert '-- "on failure" -->' in drawing
    assert "| main on failure |" in text
    assert "its branch is not taken: what it waits for did not fail" in text


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("on: failure", "on: fail", r"graph.yaml:15:26: INVALID_VALUE: found 'fail'; expected 'success' or 'failure'"),
        ("{node: main, on", "{node: mian, on", r"graph.yaml:15:13: UNKNOWN_NAME \(node\): found 'mian'"),
        (
            "{node: main, on: failure}",
            "{node: main, on: failure}, main",
            r":14:3: CYCLE: found other -> other",
        ),
        ("after: [other]", "after: [other, last]", ""),
        (
            "after: [{node: main",
            "after: [last, {node: main",
            "CYCLE: found (last|other) -> (last|other) -> ",
        ),
    ],
)
def test_a_bad_edge_is_told_with_its_place(write_graph, catalogue, old, new, told):
    problems = "\n".join(map(str, check_goal_graph(write_graph(GRAPH.replace(old, new)), catalogue)))
    assert re.search(told, problems) if told else not problems, problems


def test_a_goal_with_a_branch_needs_an_acceptance_of_its_own(write_graph, catalogue):
    text = GRAPH.replace('    accept: ["count(inside(*, green_tray)) >= 1"]\n', "")
    (problem,) = check_goal_graph(write_graph(text), catalogue)
    assert str(problem).endswith(":15:5: MISSING_VALUE: found an edge on failure; expected 'accept' of the goal")


def test_an_edge_is_read_the_same_with_on_as_a_word_and_as_a_truth_value():
    edges = [
        NodeSpec.model_validate({"skill": "pick", "after": [{"node": "a", key: "failure"}]}) for key in ("on", True)
    ]
    assert edges[0] == edges[1]
