"""Branches on failure: what runs, what is left out, and when the goal is met after all."""

import re

import pytest

from phyagentos.agent.goals.graph import check_goal_graph, read_goal_graph, render_mermaid
from phyagentos.agent.goals.spec import NodeSpec
from phyagentos.errors import Problem
from phyagentos.protocol.sessions.tasks import NodeState
from phyagentos.store.views.tasks import render_graph, render_task

from .test_mission import slip

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


def state_of(report):
    return {name: str(state) for name, state in report.nodes.items()}


def test_a_branch_that_is_not_taken_is_left_out_with_what_only_waits_for_it(make_stage, write_graph):
    stage = make_stage()
    report = stage.pursue(write_graph(GRAPH))
    assert report.verdict == "success"
    assert state_of(report) == {"last": "done", "main": "done", "other": "skipped", "behind": "skipped"}
    assert [session.node for session in stage.runtime.ran] == ["main", "last"]
    assert report.reason == "every node on a branch that was taken is done, and the criterion holds"


@pytest.mark.parametrize("how", ["missed", "refused"])
def test_a_branch_makes_up_for_a_node_that_cannot_be_done_and_what_waits_goes_on(make_stage, write_graph, how):
    stage = make_stage({"main": slip}) if how == "missed" else make_stage(refuse={"main": UNFIT})
    report = stage.pursue(write_graph(GRAPH))
    assert (report.verdict, report.exit_code) == ("success", 0)
    assert state_of(report) == {"last": "done", "main": "rescued", "other": "done", "behind": "done"}
    ran = [session.node for session in stage.runtime.ran if session.node != "main"]
    assert ran.index("other") < ran.index("last")


def test_a_goal_fails_with_its_first_cause_when_the_branch_fails_too(make_stage, write_graph):
    stage = make_stage({"main": slip, "other": slip})
    report = stage.pursue(write_graph(GRAPH))
    assert (report.verdict, report.exit_code) == ("failure", 1)
    assert set(state_of(report).values()) == {"blocked"}
    assert report.reason.startswith("node main cannot be done: ")


def test_a_goal_is_not_met_by_a_branch_alone(make_stage, write_graph):
    text = GRAPH.replace("count(inside(*, green_tray)) >= 1", "inside(red_cube, red_tray)")
    report = make_stage({"main": slip}).pursue(write_graph(text))
    assert (report.verdict, report.nodes["main"]) == ("failure", "rescued")
    assert report.reason.startswith("inside(red_cube, red_tray) is false")


def test_a_node_that_waits_for_both_ways_goes_on_after_the_one_that_was_taken(make_stage, write_graph):
    text = GRAPH.replace("after: [main]", "after: [main, other]")
    for script in ({}, {"main": slip}):
        assert make_stage(script).pursue(write_graph(text)).nodes["last"] == "done"


def test_a_node_behind_several_failures_needs_each_of_them(make_stage, write_graph):
    text = GRAPH.replace("{node: main, on: failure}", "{node: main, on: failure}, {node: last, on: failure}")
    text = text.replace("        after: [main]\n", "")
    report = make_stage({"main": slip}).pursue(write_graph(text))
    assert state_of(report) == {"last": "done", "main": "blocked", "other": "skipped", "behind": "skipped"}
    assert report.verdict == "failure"


def test_an_output_of_a_branch_that_is_not_taken_is_not_waited_for(make_stage, write_graph):
    text = GRAPH.replace("destination: green_tray}", 'destination: green_tray, near: "${other.outputs.place_site}"}')
    report = make_stage().pursue(write_graph(text))
    assert (report.nodes["last"], report.verdict) == ("skipped", "failure")  # by the goal's own acceptance


@pytest.mark.slow
@pytest.mark.parametrize(
    "script", [{}, {"main": slip}, {"main": slip, "other": slip}], ids=lambda script: "-".join(script) or "all well"
)
def test_an_agent_that_starts_anew_comes_to_the_same_end(make_stage, write_graph, script):
    whole = make_stage(script).pursue(write_graph(GRAPH))
    for killed_after in range(1, 12):
        stage = make_stage(script)

        class Kill(Exception):
            pass

        def die(_goal, ledger, stage=stage, killed_after=killed_after):
            stage.runtime.on_change(_goal, ledger)
            if ledger.seq > 3 * killed_after:
                raise Kill

        try:
            stage.make_mission(observers=[type("Dying", (), {"on_change": staticmethod(die)})()]).run(
                write_graph(GRAPH), seed=7
            )
        except Kill:
            again = stage.make_mission().run(write_graph(GRAPH), seed=7)
            assert (again.verdict, again.nodes) == (whole.verdict, whole.nodes)


def test_documents_and_drawings_say_which_branch_is_not_taken(make_stage, write_graph, catalogue):
    graph = read_goal_graph(write_graph(GRAPH), catalogue)
    assert 'n1 -. "on failure" .-> n2' in render_mermaid(graph)
    assert "n0 --> n1" not in render_mermaid(graph)
    stage = make_stage()
    mission = stage.make_mission()
    mission.run(write_graph(GRAPH), seed=7)
    goal = mission.ledger.goals["branches-7"]
    assert goal.nodes["other"].state is NodeState.SKIPPED
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
