"""`paos preflight`, with the real processes: it prints what would be granted, or why not, and moves nothing."""

import json

import msgspec
import pytest

from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.evidence import write_json
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.lookahead import LOOKAHEAD, LookaheadResult
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.journal import Entry, Journal
from tests.command_line import assert_refused

from .corpus import compile_sessions

pytestmark = pytest.mark.journey


@pytest.fixture
def workspace(tmp_path):
    return Workspace.create(tmp_path / "w", Library.open())


def test_a_goal_graph_that_fits_prints_plans_tools_and_the_dry_run(tmp_path, paos, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = paos("preflight", "two_in_a_tray", "--json")

    assert done.code == 0, done.err
    sessions = {each["session"]: each for each in json.loads(done.out)["sessions"]}
    red, beside = sessions["two_in_a_tray.red"], sessions["two_in_a_tray.beside"]
    assert red["problems"] == []
    assert red["plan"]["tree"] == "pick_and_place"
    assert [tool["name"] for tool in red["tools"]["tools"]] == red["tools"]["expose"]
    assert red["tools"]["tools"][0]["arguments"]["required"] == ["q_rad", "qd_rad_s", "gripper_width_m"]
    assert len(red["trials"]) == 4, "the posture, the grasp, the path to it, the place"
    assert {trial["outcome"] for trial in red["trials"]} == {"possible"}
    assert beside["awaits"] == {"near": "${red.outputs.place_site}"}
    assert list(tmp_path.iterdir()) == []


def test_a_goal_graph_that_does_not_compile_is_invalid_input(tmp_path, paos, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "goal_graphs").mkdir()
    graph = (Library.open().roots[-1] / "goal_graphs" / "tidy_table.yaml").read_text(encoding="utf-8")
    (tmp_path / "goal_graphs/broken.yaml").write_text(graph.replace("skill: pick_and_place", "skill: pick_and_plaice"))

    assert_refused(paos("preflight", "goal_graphs/broken.yaml"), "UNKNOWN_NAME (skill)")


def test_a_session_of_a_workspace_is_examined_as_it_was_submitted(workspace, paos):
    session = compile_sessions("tidy_table", Library.open(), workspace)[0]
    spoilt = msgspec.structs.replace(session, parameters={**session.parameters, "object": "purple_cube"})
    journal = Journal(workspace.root, side=Side.AGENT, by="test", clock=SystemClock())
    journal.commit([Entry(spoilt.id, "submit", msgspec.to_builtins(spoilt))])
    journal.close()

    foreseen = LookaheadResult(samples=8, succeeded=6, threshold=0.8, causes={"LOAD_LOST": 2}, cost_ms=1234.5)
    folder = workspace.evidence_of(spoilt.id)
    folder.mkdir(parents=True)
    write_json(folder / LOOKAHEAD, foreseen)

    done = paos("preflight", "red", "--workspace", workspace.root, "--json")

    assert done.code == 3, done.err
    (report,) = json.loads(done.out)["sessions"]
    assert (report["forecast"]["samples"], report["forecast"]["causes"]) == (8, {"LOAD_LOST": 2})
    (problem,) = report["problems"]
    assert problem["code"] == "NOT_OBSERVED"
    assert "Did you mean" in problem["hint"]


def test_what_is_neither_graph_nor_session_is_told_with_what_there_is(workspace, paos):
    assert_refused(paos("preflight", "tidy_tabel", "--workspace", workspace.root), "no such session")
