"""Actions of the page: each leaves what the command of the CLI would leave."""

from pathlib import Path

import msgspec
import pytest
import yaml

from phyagentos.agent.tools.proposals import Proposal, Proposals, encode_proposal
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.operations import submit
from phyagentos.protocol.sessions import estop
from phyagentos.protocol.sessions.stop_signals import take_signals
from phyagentos.store.edits.inbox import read_request
from phyagentos.store.edits.request_form import plan
from phyagentos.view.actions import ACTIONS, perform

TIDY = (Path(__file__).resolve().parents[2] / "goal_graphs" / "tidy_table.yaml").read_text(encoding="utf-8")


@pytest.fixture
def planes(desk, monkeypatch):
    """What is started instead of planes: name -> arguments; the agent submits its goal at once."""
    started = {}

    class Plane:
        def __init__(self, name, arguments, logs, *, outlives):
            assert outlives
            started[name], self.name, self.log = arguments, name, logs / f"{name}.log"
            if name == "agent":
                goal = arguments[arguments.index("--goal") + 1]
                desk.record(f"goal:{goal}", "goal_submitted", graph="tidy_table", seed=0, objective="Tidy.")

    monkeypatch.setattr(submit, "Plane", Plane)
    return started


def test_one_press_latches_the_emergency_stop_and_a_reset_asks_for_a_reason(documents):
    signals = documents.workspace.signals.parent
    perform(documents.workspace, "estop", {})
    assert estop.read_latch(signals).reason == "pressed on the page"
    with pytest.raises(DefinitionError, match="MISSING_VALUE"):
        perform(documents.workspace, "reset", {"reason": " "})
    assert estop.is_latched(signals)
    perform(documents.workspace, "reset", {"reason": "the table is free"})
    assert not estop.is_latched(signals)


def test_a_cancel_is_the_request_that_the_command_makes(documents, desk):
    third = desk.submit("b")
    done = perform(documents.workspace, "cancel", {"session": third, "reason": "supper"})
    (signal,) = take_signals(documents.workspace.signals)
    assert (signal.kind, signal.session, signal.reason, signal.by) == ("cancel", third, "supper", "paos cancel")
    assert done.command == f"paos cancel {third} --reason='supper' -w {documents.workspace.root}"


def test_an_amendment_is_a_request_that_the_inbox_takes(documents, desk):
    third = desk.submit("b")
    documents.refresh()
    perform(documents.workspace, "amend", {"session": third, "timeout_s": "12.5", "priority": "3"})
    (asked,) = (documents.workspace.inbox / "new").glob("*.yaml")
    entry = plan(*read_request(asked), asked.stem, documents.ledger.sessions)
    assert (entry.id, entry.ev) == (third, "amend")
    assert msgspec.to_builtins(entry.body) == {"limits": {"timeout_s": 12.5}, "priority": 3}


BAD = ["soon", "-1", "1\npriority: 9", "nan", "[1", "!!python/name:os.system"]


@pytest.mark.parametrize(
    ("field", "value"),
    [*(("timeout_s", each) for each in BAD), *(("priority", each) for each in ("1e400", "nan", "1.5", "9" * 30))],
)
def test_an_amendment_that_no_session_could_take_is_refused_on_the_page(documents, desk, field, value):
    with pytest.raises(DefinitionError):
        perform(documents.workspace, "amend", {"session": desk.submit("b"), field: value})
    assert not list(documents.workspace.inbox.glob("*/*.yaml"))


def test_a_graph_that_is_unsound_is_linted_and_not_submitted(documents):
    with pytest.raises(DefinitionError, match=r"UNKNOWN_NAME \(key\)"):
        perform(documents.workspace, "submit", {"graph": "goal: tidy\nsesions: {}\n"})
    assert not list(documents.workspace.logs.glob("*.log"))


@pytest.mark.parametrize("name", [name for name, action in ACTIONS.items() if action.needs])
def test_an_empty_field_is_refused(reported, name):
    with pytest.raises(DefinitionError, match="MISSING_VALUE"):
        perform(reported.workspace, name, dict.fromkeys(ACTIONS[name].needs, " "))


def test_an_unknown_action_names_those_that_there_are(reported):
    with pytest.raises(DefinitionError, match="cancel"):
        perform(reported.workspace, "launch", {})


def test_a_sound_graph_is_pursued_by_planes_that_outlive_the_page(desk, planes):
    done = perform(desk.workspace, "submit", {"graph": TIDY})
    assert list(planes) == ["agent", "watch"]
    assert "--once-idle" in planes["watch"]
    assert (done.result.goal, len(done.result.logs)) == ("tidy_table-0", 2)


def test_an_approved_proposal_is_pursued_with_its_own_seed(desk, planes):
    facts = {"by": "mcp", "at": "2026-01-01T00:00:00Z", "reason": "tidy", "decider": "person"}
    proposed = encode_proposal(Proposal(goal="tidy_table", seed=5, graph=yaml.safe_load(TIDY), **facts))
    proposals = Proposals(desk.workspace.proposals)
    proposals.put(proposed)
    perform(desk.workspace, "approve", {"proposal": proposed.name, "sha256": proposed.sha256})
    assert proposals.find_decision(proposed).decision == "approved"
    assert planes["agent"][planes["agent"].index("--seed") + 1] == "5"


def test_an_agent_that_does_not_begin_is_named_with_what_it_printed(desk, monkeypatch):
    def start(name, _arguments, logs, *, outlives):
        return Ended(name, logs)

    class Ended:
        def __init__(self, name, logs):
            self.name, self.log = name, logs / f"{name}.log"

        def find_exit_code(self):
            return 2

        def read_printed(self):
            return ["no memory"]

    monkeypatch.setattr(submit, "Plane", start)
    with pytest.raises(ExecutionError, match="agent plane ended with code 2: no memory"):
        perform(desk.workspace, "submit", {"graph": TIDY})
