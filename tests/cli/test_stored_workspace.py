"""A workspace that an earlier version recorded still opens: its journal, documents, bundles and verdicts."""

import json

import pytest

from phyagentos.cli.outcome import ExitCode
from phyagentos.protocol.sessions.lifecycle import SessionState, Side
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.journal import Journal
from phyagentos.testing import ManualClock
from tests.goal_graphs import check_recorded_graphs
from tests.stored_workspace import unpack_stored

GOAL = "tidy_table-7"
CONTENT_SHA256 = "94c6778454830a45393df91ae799d46a116781548ceaf9b5859fb9a39d3320fa"


@pytest.fixture
def stored(tmp_path):
    return unpack_stored(tmp_path)


def test_its_journal_is_whole_and_hashes_as_it_did(stored, paos):
    done = paos("store", "check", stored, "--json")
    assert done.code == ExitCode.GOAL_MET
    assert json.loads(done.out)["sha256"] == CONTENT_SHA256


def test_its_sessions_stand_as_they_ended(stored):
    ledger = Journal(Workspace.open(stored).root, side=Side.OPERATOR, by="test", clock=ManualClock()).open_ledger()
    states = {id: status.state for id, status in ledger.sessions.items()}
    assert states == {
        f"{GOAL}.red": SessionState.REPLANNED,
        f"{GOAL}.red.r1": SessionState.SUCCEEDED,
        f"{GOAL}.green": SessionState.SUCCEEDED,
        f"{GOAL}.blue": SessionState.SUCCEEDED,
    }
    assert ledger.goals[GOAL].verdict == "success"


def test_why_tells_cause_and_child(stored, paos):
    told = paos("why", "red", "-w", stored).out
    assert "GRASP_LOST" in told
    assert f"{GOAL}.red.r1" in told
    assert "with another grasp (not yaw 0°) at half speed" in told


def test_its_graph_shows_the_child_and_is_that_of_an_agent_of_today(stored, paos):
    assert "  red.r1  done         after red (replan)\n" in paos("graph", "-w", stored).out
    check_recorded_graphs(stored)


def test_its_evidence_is_judged_again_as_it_was(stored, paos):
    judged = paos("verify", f"{GOAL}.red.r1", "-w", stored, "--json")
    assert judged.code == ExitCode.GOAL_MET
    assert json.loads(judged.out)["verdict"] == "success"


@pytest.mark.slow
def test_its_documents_lint(stored, paos):
    assert paos("lint", stored).code == ExitCode.GOAL_MET
