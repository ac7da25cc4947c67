"""What a person reads after a run: what was asked, who did it, what was seen, why the verdict fell as it did."""

import re

import msgspec
import pytest

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.documents.document import iter_blocks, read_document
from phyagentos.protocol.documents.markdown import publish
from phyagentos.protocol.documents.schema import parse_yaml
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import SESSIONS, Ended, Execution
from phyagentos.protocol.sessions.tasks import GoalStatus, NodeState, NodeStatus, Replan
from phyagentos.protocol.sessions.verdicts import Attempt, Criterion, Verdict
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.truth import Truth
from phyagentos.store.edits.edit_intake import EditIntake
from phyagentos.store.journal import Entry
from phyagentos.store.ledger import Ledger
from phyagentos.store.renderer import Views
from phyagentos.store.views.sessions import FINISHED_SHOWN, build_page, render_page
from phyagentos.store.views.tasks import render_graph, render_tasks

from .conftest import make_course
from .histories import fold

EXECUTION = Execution(
    ended=Ended.SKILL_FAILED,
    evidence="evidence/tidy-7.red",
    leaf="pick_and_place/verify_grasp",
    code="GRASP_LOST",
    message="the fingers closed to 0.001 m",
    sim_time_s=9.2,
    ticks=460,
    interventions=2,
)
ATTEMPT = Attempt(
    verdict=Verdict.REPLAN,
    criteria=(
        Criterion(
            text="inside(red_cube, red_tray)",
            kind="accept",
            truth=Truth.FALSE,
            measured={"distance_m": 0.312345},
            evidence="environment_after.json",
            because="it lies 0.31 m beside the tray",
        ),
    ),
    cause="GRASP_LOST",
    reason="verify_grasp measured 0.001 m | less than the cube",
)


@pytest.fixture
def run(open_journal, submit):
    """One goal of two nodes: the first was replanned and its child waits."""
    agent, runtime = open_journal(by="mission"), open_journal(Side.RUNTIME, "watchdog")
    nodes = {"red": {"objective": "the red cube", "skill": "pick_and_place"}, 'blue "x"': {"after": ["red"]}}
    agent.commit(
        [
            Entry("goal:tidy-7", "goal_submitted", {"graph": "tidy", "seed": 7, "objective": "Tidy the table"}),
            Entry("goal:tidy-7", "goal_compiled", {"nodes": nodes, "accept": ["count(inside(*, red_tray)) >= 1"]}),
            Entry("node:tidy-7/red", "node_ready"),
            submit(),
        ]
    )
    runtime.commit(make_course("tidy-7.red", EXECUTION))
    child = {"child": "tidy-7.red.r1", "parent": "tidy-7.red", "reason": "the cube slipped"}
    agent.commit(
        [
            Entry("tidy-7.red", "verify"),
            Entry("tidy-7.red", "replan", {"attempt": ATTEMPT}),
            Entry("node:tidy-7/red", "child_of", child),
            Entry("node:tidy-7/red", "budget_spent"),
            submit(
                "tidy-7.red.r1",
                parent="tidy-7.red",
                attempt=1,
                strategy={"avoid_grasps": ["yaw+000", "yaw+090"], "speed": 0.5},
            ),
        ]
    )
    return agent


@pytest.fixture
def ledger(run):
    return fold(run.read_new())


def test_a_session_tells_what_was_asked_who_did_it_what_was_seen_and_why(ledger):
    text = render_page(build_page(ledger))
    section = text[text.index("## tidy-7.red\n") :]

    for fact in (
        "**Asked:** Put the red cube into the red tray (`pick_and_place` on `panda`; object = red_cube",
        "**Done by:** watchdog, epoch 1",
        "skill failed at `pick_and_place/verify_grasp` (GRASP_LOST): the fingers closed to 0.001 m; 9.20 s simulated",
        "2 safety interventions",
        "[evidence/tidy-7.red](evidence/tidy-7.red)",
        "**Verdict 1:** replan (GRASP_LOST): verify_grasp measured 0.001 m",
        "| `inside(red_cube, red_tray)` | accept | **no** | it lies 0.31 m beside the tray | distance_m = 0.3123 |",
    ):
        assert fact in section
    assert "**Revises:** `tidy-7.red`; differently: with another grasp (not yaw 0° or yaw 90°) at half speed" in text
    assert text.startswith("---\nphy: sessions/1\nview: 14\n---\n")
    assert text.count("stateDiagram-v2") == 1
    assert text.endswith("<!-- end of view -->\n")
    blocks = read_document(text, SESSIONS).blocks
    assert (blocks, list(blocks)) == (ledger.sessions, ["tidy-7.red.r1", "tidy-7.red"])


def test_sessions_shows_all_live_ones_and_the_last_finished(open_journal, submit):
    agent = open_journal()
    agent.commit([submit(f"s{number}") for number in range(120)])
    agent.commit([Entry(f"s{number}", "cancel") for number in range(100)])
    text = render_page(build_page(fold(agent.read_new())))
    names = [block.name for block in iter_blocks(text)]

    assert names == [f"s{n}" for n in range(100, 120)] + [f"s{n}" for n in range(99, 99 - FINISHED_SHOWN, -1)]
    assert "50 older sessions are in the journal." in text


def test_a_pending_session_shows_every_field_that_may_change(ledger):
    text = render_page(build_page(ledger))
    pending, replanned = text[text.index("## tidy-7.red.r1\n") :].split("## tidy-7.red\n")

    for name in ("timeout_s: 60.0", "wall_timeout_s: 120.0", "queue_s: 3600.0", "heartbeat_s: 10.0", "priority: 0"):
        assert f"{name}\n" in pending
        assert name not in replanned


def test_no_objective_can_break_the_page(open_journal, submit):
    agent = open_journal()
    agent.commit([submit("a", objective="x\n## fake\n```yaml\nstate: y\n```\n<!-- end of view -->\n"), submit("b")])
    text = render_page(build_page(fold(agent.read_new())))

    assert [block.name for block in iter_blocks(text)] == ["a", "b"]
    assert text.count("\n<!-- end of view -->\n") == 1


def test_what_is_shown_no_more_is_forgotten(open_journal, submit):
    agent, ledger, cache = open_journal(), Ledger(), {}
    for number in range(300):
        agent.commit([submit(f"s{number}"), Entry(f"s{number}", "cancel")])
        fold(agent.read_new(), ledger)
        render_page(build_page(ledger), cache)

    assert len(cache) <= 3 * FINISHED_SHOWN + 2


def test_a_task_shows_goal_nodes_criteria_and_verdict(run, ledger):
    verdict = {"verdict": "success", "reason": "both cubes are in", "criteria": ATTEMPT.criteria}
    fold(run.commit([Entry("goal:tidy-7", "goal_verdict", verdict)]), ledger)
    text = render_tasks(ledger)

    for fact in (
        "## tidy-7\n",
        "**Asked:** Tidy the table (graph `tidy`, seed 7, submitted by mission, 1970-01-12 ",
        ": both cubes are in",
        "**Sessions:** 2, replans: 1",
        "`count(inside(*, red_tray)) >= 1`",
        "| red | active | the red cube | pick_and_place |  | "
        "[tidy-7.red](evidence/tidy-7.red) (replanned), tidy-7.red.r1 (pending) |  |",
        "| [tidy-7.red](evidence/tidy-7.red) | tidy-7.red.r1 | GRASP_LOST: verify_grasp measured 0.001 m",
        "| `inside(red_cube, red_tray)` | accept | **no** |",
    ):
        assert fact in text
    (block,) = iter_blocks(text)
    assert msgspec.convert(parse_yaml(block.yaml, "TASK.md").data, GoalStatus) == ledger.goals["tidy-7"]


def test_a_workspace_without_goals_says_so():
    assert "No goal has been submitted yet." in render_tasks(Ledger())
    assert "No session has been submitted yet." in render_page(build_page(Ledger()))


def test_the_graph_is_quoted_mermaid_coloured_by_state():
    child = Replan(session="g.end", child="g.end.r1", reason="", relation="clears")
    nodes = {"end": NodeStatus(state=NodeState.DONE, sessions=("g.end", "g.end.r1"), replans=(child,))}
    nodes['a "b" <c>; `d` #e'] = NodeStatus(after=("end", "elsewhere"))
    lines = render_graph(GoalStatus(id="g", nodes=nodes)).splitlines()

    assert lines[:6] == [
        "flowchart TD",
        '    n0["<b>end</b><br/>past"]:::past',
        '    n1["<b>end.r1</b><br/>done"]:::done',
        '    n2["<b>a #quot;b#quot; #lt;c#gt;#59; #96;d#96; #35;e</b><br/>waiting"]:::waiting',
        '    n0 -- "clears" --> n1',
        "    n1 --> n2",
    ]
    assert {line.split()[1] for line in lines[6:]} == {*NodeState, "past"}
    for line in lines[6:]:
        assert re.fullmatch(r"    classDef \w+ fill:#[0-9a-f]{6},stroke:#[0-9a-f]{6},color:#[0-9a-f]{6}", line)


def test_views_follow_the_journal_at_a_readable_rate(tmp_path, run, submit, clock):
    workspace = Workspace.create(tmp_path / "w", Library(()))
    views = Views(workspace, run.folder, clock, EditIntake(workspace, clock))

    assert views.refresh() is True
    assert views.refresh() is False
    run.commit([submit("late")])
    assert views.refresh() is False
    clock.advance(0.25)
    assert views.refresh() is True
    run.commit([Entry("late", "cancel", {"reason": "too late"})])
    views.close()

    assert "## late\n" in workspace.sessions_document.read_text()
    assert "**late** (mission) cancelled: too late" in workspace.log.read_text()
    assert views.ledger.sessions["late"].state == "cancelled"


def test_publishing_replaces_a_document_as_a_whole(tmp_path):
    path = tmp_path / "LOG.md"
    publish(path, "old")
    with path.open() as reader:
        publish(path, "new")
        assert reader.read() == "old"

    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]
