"""`paos amend`: the difference, what is refused, and what is recorded where no agent answers."""

import json
from contextlib import closing

import msgspec
import pytest

from phyagentos.agent.goals.amendment import describe_node
from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.compiler import SessionCompiler
from phyagentos.agent.goals.graph import read_goal_graph
from phyagentos.clock import SystemClock
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.admission import Entry
from phyagentos.store.journal import Journal
from tests.command_line import assert_refused

GOAL = GoalId("tidy_table-7")
TIDY = find_shipped_root() / "goal_graphs" / "tidy_table.yaml"


@pytest.fixture(scope="module")
def library():
    return Library((find_shipped_root(),))


@pytest.fixture
def workspace(tmp_path, library):
    """A goal of three nodes, of which `red` has a session, and no agent."""
    place = Workspace.create(tmp_path / "run", library)
    catalogue = Catalogue.of_workspace(place)
    graph = read_goal_graph(TIDY, catalogue)
    place.goal_file_of(GOAL).write_bytes(TIDY.read_bytes())
    red = SessionCompiler(graph=graph, catalogue=catalogue, goal=GOAL, seed=7).compile_node("red")
    nodes = {name: describe_node(graph, name) for name in graph.nodes}
    compiled = {"nodes": nodes, "accept": list(graph.spec.accept), "constraints": list(graph.spec.constraints)}
    with closing(Journal(place.root, side=Side.AGENT, by="agent", clock=SystemClock(), durable=False)) as journal:
        begun = [Entry(f"goal:{GOAL}", "goal_submitted"), Entry(f"goal:{GOAL}", "goal_compiled", compiled)]
        journal.commit([*begun, Entry(red.id, "submit", msgspec.to_builtins(red))])
    return place


@pytest.fixture
def wanted(tmp_path):
    def write(*changes):
        text = TIDY.read_text()
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        file = tmp_path / "wanted.yaml"
        file.write_text(text)
        return file

    return write


GREEN_LAST = ("  green:\n", "  green:\n    after: [blue]\n")


def test_the_difference_is_shown_and_asked_for_and_answered_later(workspace, wanted, paos):
    result = paos("amend", GOAL, wanted(GREEN_LAST), "-w", workspace.root, "--wait", "0")
    assert (result.code, result.out) == (0, "~ green: pick_and_place on panda after blue\n")
    assert "the agent answers as soon as it goes on with this goal" in result.err
    (file,) = read_ledger(workspace.root).goals[GOAL].asked
    assert "after: [blue]" in (workspace.goals / file).read_text()


def test_a_dry_run_records_nothing(workspace, wanted, paos):
    result = paos("amend", GOAL, wanted(GREEN_LAST), "-w", workspace.root, "--dry-run", "--json")
    assert json.loads(result.out)["difference"]["nodes"]["green"]["after"] == ["blue"]
    assert read_ledger(workspace.root).goals[GOAL].asked == ()
    assert len(list(workspace.goals.iterdir())) == 1


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        (
            [("object: red_cube, destination: red_tray", "object: red_cube, destination: blue_tray")],
            "changed: arguments",
        ),
        ([("goal: tidy_table", "goal: other")], "CHANGED"),
        ([("skill: pick_and_place", "skill: pick_and_plaice")], "Did you mean 'pick_and_place'?"),
    ],
)
def test_what_contradicts_or_cannot_run_is_refused_and_nothing_is_recorded(workspace, wanted, paos, changes, told):
    assert_refused(paos("amend", GOAL, wanted(*changes), "-w", workspace.root), told)
    assert read_ledger(workspace.root).goals[GOAL].asked == ()


def test_a_goal_that_is_not_there_or_over_is_told(workspace, wanted, paos):
    assert "Did you mean 'tidy_table-7'?" in paos("amend", "tidy_table-8", wanted(), "-w", workspace.root).err
    with closing(Journal(workspace.root, side=Side.AGENT, by="agent", clock=SystemClock(), durable=False)) as journal:
        journal.commit([Entry(f"goal:{GOAL}", "goal_verdict", {"verdict": "failure"})])
    result = paos("amend", GOAL, wanted(), "-w", workspace.root)
    assert (result.code, "its verdict, failure, which is final" in result.err) == (2, True)
