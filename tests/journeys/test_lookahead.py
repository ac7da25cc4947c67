"""A failure is foreseen from what the cameras see, and the session is revised before a motor moves."""

import json
from pathlib import Path

import pytest

from phyagentos.protocol.sessions.lookahead import read_lookahead
from phyagentos.store.history import Histories
from phyagentos.store.journal import choose_partition

GRAPH = Path(__file__).resolve().parents[2] / "benchmarks" / "lookahead_parts" / "balance.yaml"

pytestmark = pytest.mark.journey


def test_a_block_that_would_tip_the_board_is_put_elsewhere_before_a_motor_moves(plane):
    report = plane.mission.run(GRAPH, seed=0, goal="balance")

    refused, *revised = report.sessions
    assert report.verdict == "success", report
    assert (refused.id, refused.state, refused.ticks) == ("balance.load", "rejected", 0)
    assert report.replans == 0, "a refusal spends no replan"
    foreseen, last = (read_lookahead(plane.bundle(session.id)) for session in (refused, revised[-1]))
    assert foreseen.is_low
    assert foreseen.likely_cause in {"PLACED_WRONG", "OBJECT_MOVED"}
    assert not last.is_low
    assert "sensing perceived" in foreseen.notes[0]

    with Histories(plane.workspace.sessions / choose_partition(plane.workspace.sessions)) as histories:
        refusals = [record for record in histories.find(refused.id) if record.ev == "reject"]
        (submitted,) = [record for record in histories.find(revised[-1].id) if record.ev == "submit"]
    assert "LOOKAHEAD_LOW" in refusals[0].body["reason"]
    assert submitted.body["strategy"] != {}
    assert submitted.at > refusals[0].at
    lines = (plane.workspace.logs / "receive-panda.jsonl").read_text(encoding="utf-8").splitlines()
    heard = [each for each in map(json.loads, lines) if each.get("episode") == "balance"]
    commands = [each for each in heard if each["kind"] == "Command"]
    assert {each["session"] for each in commands} == {revised[-1].id}
    assert min(each["at"] for each in commands) > submitted.at
