"""What is kept from record to record is what the records tell."""

import pytest

from phyagentos.agent.mission import mission
from phyagentos.agent.mission.worklist import Worklist
from phyagentos.errors import Problem
from phyagentos.protocol.sessions.tasks import iter_edges
from tests.goal_graphs import assert_same_graph

from .conftest import TIDY, slip
from .test_mission import CHAIN, undo_red
from .test_restoration import HEAD, ROW, take_out


@pytest.fixture
def compare(monkeypatch):
    """After every record, worklist and graph that followed them all equal those made anew, and what records draw."""
    compared = []

    def take_in_and_compare(worklist, record):
        take_in(worklist, record)
        goal = worklist.ledger.goals.get(worklist.goal)
        if goal is not None and goal.nodes:
            anew = Worklist(graphs[-1], worklist.goal, worklist.ledger)
            assert_same_graph(worklist.dag, goal)
            assert_same_graph(anew.dag, goal)
            assert sorted(worklist.iter_live()) == sorted(anew.iter_live()), record
            assert sorted(worklist.iter_unjudged()) == sorted(anew.iter_unjudged()), record
            pending = [id for id in worklist.iter_live() if worklist.ledger.sessions[id].state == "pending"]
            assert worklist.count_waiting() == anew.count_waiting() == len(pending), record
            compared.append(record.ev)

    take_in, graphs = Worklist.take_in, []
    read = mission.read_goal_graph
    monkeypatch.setattr(mission, "read_goal_graph", lambda *given: graphs.append(read(*given)) or graphs[-1])
    monkeypatch.setattr(Worklist, "take_in", take_in_and_compare)
    return compared


def test_it_follows_sessions_replans_and_ends(make_stage, write_graph, compare):
    report = make_stage({"red": slip}).pursue(write_graph(TIDY))
    assert report.verdict == "success"
    assert {"submit", "finish", "replan", "child_of", "node_done"} <= set(compare)


def test_it_follows_a_node_that_the_world_undid(make_stage, write_graph, compare):
    report = make_stage({"green": undo_red}).pursue(write_graph(TIDY))
    assert report.verdict == "success"
    assert "invalidated" in compare


def test_a_begun_node_waits_for_what_is_done_again_two_nodes_before_it(make_stage, write_graph, compare):
    stage = make_stage({"red": take_out("green_cube", slip)})
    assert stage.pursue(write_graph(HEAD + ROW.replace("REPLANS", "2"))).verdict == "success"
    assert "node_waits" in compare
    edges = iter_edges(stage.make_mission().ledger.goals["again-7"])
    assert {(edge.before, edge.step): edge.relation for edge in edges} == {
        ("green", "green.r1"): "again",
        ("green.r1", "blue"): "after",
        ("blue", "red"): "after",
        ("red", "red.r1"): "replan",
        ("green.r1", "red.r1"): "restores",
    }


def test_it_follows_nodes_that_are_blocked_one_behind_the_other(make_stage, write_graph, compare):
    report = make_stage(refuse={"red": Problem(code="NO", address="red")}).pursue(write_graph(CHAIN))
    assert set(report.nodes.values()) == {"blocked"}
    assert compare.count("node_blocked") == 4


@pytest.mark.slow
def test_a_long_row_of_nodes_behind_a_blocked_one_is_blocked(make_stage, write_graph, compare):
    sessions = ["red: {skill: pick_and_place, with: {object: red_cube, destination: red_tray}}"]
    for index in range(60):
        before = f"n{index - 1}" if index else "red"
        sessions.append(
            f"n{index}: {{after: [{before}], skill: pick_and_place, with: {{object: red_cube, destination: red_tray}}}}"
        )
    lines = "\n".join(f"  {line}" for line in sessions)
    graph = write_graph(f"goal: long\nobjective: A long way.\nscene: table\nsessions:\n{lines}\n")
    stage = make_stage(refuse={"red": Problem(code="NO", address="red")})
    report = stage.pursue(graph)
    assert list(report.nodes.values()).count("blocked") == 61


def test_a_graph_too_large_for_one_record_takes_several(make_stage, write_graph, monkeypatch):
    monkeypatch.setattr("phyagentos.agent.mission.goal_controller.NODES_A_RECORD", 1)
    report = make_stage().pursue(write_graph(TIDY))
    assert report.verdict == "success"
    assert list(report.nodes) == ["red", "green"]
    assert len(report.criteria) == 3
