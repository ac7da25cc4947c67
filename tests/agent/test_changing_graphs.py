"""Graphs that change while they are pursued: fan-outs over what is seen, conditions, alternatives, amendments."""

import re
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from phyagentos.agent.goals.amendment import compute_difference, describe_node
from phyagentos.agent.goals.compiler import SessionCompiler
from phyagentos.agent.goals.graph import check_goal_graph, read_goal_graph
from phyagentos.agent.mission.task_document import TaskDocument
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.protocol.sessions.tasks import NodeState
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.admission import Entry
from phyagentos.store.journal import Journal
from phyagentos.store.ledger import Ledger

from .conftest import check_report, get_order, make_world, put, remove, slip, succeed

HEAD = """
    goal: changing
    objective: As it comes.
    scene: table
    targets: {arm: panda}
    defaults: {max_replans: 0}
    sessions:
      first:
        skill: pick_and_place
        with: {object: red_cube, destination: red_tray}
    """
EACH = """
      each:
        after: [first]
        foreach: {thing: "inside(${thing}, red_tray)"}
        skill: pick_and_place
        with: {object: "${thing}", destination: green_tray}
      last:
        after: [each]
        skill: pick_and_place
        with: {object: blue_cube, destination: blue_tray}
    accept: ["count(inside(*, green_tray)) == %d"]
    """
MAYBE = """
      maybe:
        after: [first]
        when: ["%s"]
        skill: pick_and_place
        with: {object: green_cube, destination: green_tray}
      last:
        after: [maybe]
        skill: pick_and_place
        with: {object: blue_cube, destination: blue_tray}
    """
EITHER = """
      either:
        after: [first]
        accept: ["inside(green_cube, green_tray)"]
        any_of:
          - {skill: pick_and_place, with: {object: green_cube, destination: green_tray}}
          - {skill: pick_and_place, with: {object: green_cube, destination: green_tray, speed: 0.5}}
          - {skill: pick_and_place, with: {object: green_cube, destination: green_tray, speed: 0.2}}
      last:
        after: [either]
        skill: pick_and_place
        with: {object: blue_cube, destination: blue_tray}
    accept: ["inside(green_cube, green_tray)"]
    """


def two_in_red_tray():
    world = put(make_world(), "yellow_cube", (0.6, 0.3, 0.03))
    return put(world, "red_cube", (0.4, 0.3, 0.02))


NOTHING_FITS = (HEAD + EACH % 0).replace("inside(${thing}, red_tray)", "inside(${thing}, blue_tray)")
NEVER = (
    (HEAD + EITHER)
    .replace("        any_of:", '        when: ["holding(arm, red_cube)"]\n        any_of:')
    .replace('green_cube, green_tray)"]', 'blue_cube, blue_tray)"]')
)


def choose(first, second, third, last="done"):
    """The nodes of the graph with alternatives."""
    return {"first": "done", "either-1": first, "either-2": second, "either-3": third, "last": last}


@pytest.mark.parametrize(
    ("text", "stage", "verdict", "nodes"),
    [
        pytest.param(
            HEAD + EACH % 2,
            {"world": two_in_red_tray()},
            "success",
            dict.fromkeys(("first", "last", "each-red_cube", "each-yellow_cube"), "done"),
            id="a fan-out over what is seen becomes its nodes",
        ),
        pytest.param(
            NOTHING_FITS,
            {},
            "success",
            {"first": "done", "each": "skipped", "last": "done"},
            id="a fan-out to which nothing fits is left out and what waits for it goes on",
        ),
        pytest.param(
            HEAD + MAYBE % "inside(red_cube, red_tray)",
            {},
            "success",
            {"first": "done", "maybe": "done", "last": "done"},
            id="a condition that is true on what is seen",
        ),
        pytest.param(
            HEAD + MAYBE % "holding(arm, blue_cube)",
            {},
            "success",
            {"first": "done", "maybe": "skipped", "last": "done"},
            id="what waits goes on where a condition is false",
        ),
        pytest.param(HEAD + EITHER, {}, "success", choose("done", "skipped", "skipped"), id="the first alternative"),
        pytest.param(
            HEAD + EITHER,
            {"script": {"either-1": slip}},
            "success",
            choose("rescued", "done", "skipped"),
            id="the second one when the first has failed",
        ),
        pytest.param(
            HEAD + EITHER,
            {"script": {"either-1": slip, "either-2": slip}},
            "success",
            choose("rescued", "rescued", "done"),
            id="the third one when both have failed",
        ),
        pytest.param(
            HEAD + EITHER,
            {"script": {"either-1": slip, "either-2": slip, "either-3": slip}},
            "failure",
            choose("blocked", "blocked", "blocked", "blocked"),
            id="no alternative is left",
        ),
        pytest.param(
            NEVER,
            {"script": {"either-1": slip}},
            "success",
            choose("skipped", "skipped", "skipped"),
            id="alternatives whose condition is false are all left out and what waits goes on",
        ),
    ],
)
def test_what_is_seen_and_what_has_failed_decide_which_nodes_there_are(
    make_stage, write_graph, text, stage, verdict, nodes
):
    check_report(make_stage(**stage).pursue(write_graph(text)), verdict=verdict, nodes=nodes)


def test_a_fan_out_over_what_is_seen_runs_between_what_is_before_and_behind_it(make_stage, write_graph):
    stage = make_stage(world=two_in_red_tray())
    stage.pursue(write_graph(HEAD + EACH % 2))
    assert get_order(stage) == ["first", "each-red_cube", "each-yellow_cube", "last"]


def test_a_condition_that_cannot_be_told_blocks_its_node_and_says_why(make_stage, write_graph):
    stage = make_stage(world=remove(make_world(), "yellow_cube"))
    report = stage.pursue(write_graph(HEAD + MAYBE % "inside(yellow_cube, red_tray)"))
    unknown = "node maybe cannot be done: its condition is unknown: inside(yellow_cube, red_tray)"
    check_report(report, {"": unknown}, verdict="failure")


def test_a_mistake_in_an_alternative_is_reported_where_it_stands(catalogue, write_graph):
    text = (HEAD + EITHER).replace("speed: 0.2", "spede: 0.2")
    (problem,) = check_goal_graph(write_graph(text), catalogue)
    assert problem.label == "UNKNOWN_NAME (parameter)"
    assert problem.address.endswith("graph.yaml:17:85")


def test_a_choice_among_fewer_than_two_alternatives_is_refused(catalogue, write_graph):
    text = (
        HEAD
        + """
      either:
        after: [first]
        any_of: []
    accept: ["inside(green_cube, green_tray)"]
    """
    )
    (problem,) = check_goal_graph(write_graph(text), catalogue)
    assert (problem.code, problem.address.split(":")[-2]) == ("INVALID_VALUE", "13")


def test_what_a_predicate_names_is_not_among_what_fits_it(make_stage, write_graph):
    tray_in_itself = "inside(${thing}, red_tray) or visible(${thing}) and inside(red_cube, red_tray)"
    text = (HEAD + EACH % 1).replace("inside(${thing}, red_tray)", tray_in_itself)
    ran = make_stage().pursue(write_graph(text)).nodes
    assert {"each-red_tray", "each-red_cube"}.isdisjoint(ran)
    assert "each-green_cube" in ran


@pytest.mark.parametrize(
    ("old", "new", "code", "line"),
    [
        ("after: [first]\n        foreach", "foreach", "NOT_OBSERVED", 12),
        ("inside(${thing}, red_tray)", "inside(*, red_tray)", "INVALID_VALUE", 13),
        ("inside(${thing}, red_tray)", "inside(${thing}, tub)", "UNKNOWN_NAME (object)", 13),
        ("inside(${thing}, red_tray)", "inside(${thing}", "SYNTAX", 13),
    ],
)
def test_a_fan_out_over_what_is_seen_is_checked_before_anything_runs(catalogue, write_graph, old, new, code, line):
    text = HEAD + EACH % 1
    assert old in text
    problems = check_goal_graph(write_graph(text.replace(old, new)), catalogue)
    assert [(each.label, each.address.split(":")[-2]) for each in problems] == [(code, str(line))]


WANTED = """
      next:
        after: [first]
        skill: pick_and_place
        with: {object: green_cube, destination: green_tray}
    """
OTHER = """
      other:
        after: [first]
        skill: pick_and_place
        with: {object: blue_cube, destination: blue_tray}
    """


def ask(stage, graph, goal="changing-7"):
    """What `paos amend` leaves: the wanted graph, and a record."""
    content = graph.read_bytes()
    file = stage.workspace.amended_file_of(GoalId(goal), content)
    file.write_bytes(content)
    operator = Journal(stage.workspace.root, side=Side.OPERATOR, by="paos amend", clock=SystemClock(), durable=False)
    operator.commit([Entry(f"goal:{goal}", "amendment_asked", {"file": file.name})])
    operator.close()


@pytest.fixture
def amend(make_stage, write_graph):
    """Pursues a graph that a person wants to be another one while a session runs."""

    def run(old, new, at="first", script=None):
        stage = make_stage(script)
        wanted, own = write_graph(new, "wanted.yaml"), stage.runtime.script.get(at)

        def play(world, session):
            ask(stage, wanted)
            return (own or succeed)(world, session)

        stage.runtime.script[at] = play
        mission = stage.make_mission()
        return mission.run(write_graph(old), seed=7), mission.ledger.goals[GoalId("changing-7")], stage

    return run


@pytest.mark.parametrize(
    ("wanted", "ran", "change"),
    [
        pytest.param(
            HEAD + OTHER, ["first", "other"], "as a person asked for", id="what is open is taken out and others added"
        ),
        pytest.param(
            (HEAD + OTHER).replace("red_cube", "yellow_cube"),
            ["first", "next"],
            r"refused: .*node 'first': CHANGED: found it is active, by changing-7\.first; changed: arguments",
            id="what contradicts what has begun",
        ),
        pytest.param(
            HEAD.replace("first:", "begun:") + OTHER.replace("[first]", "[begun]"),
            ["first", "next"],
            r"refused: .*node 'first': CHANGED: found it is active, by changing-7\.first, and was taken out",
            id="what has begun cannot be taken out",
        ),
        pytest.param(
            (HEAD + OTHER).replace("pick_and_place\n        with: {object: blue", "jump\n        with: {object: blue"),
            ["first", "next"],
            r"refused: .*UNKNOWN_NAME \(skill\)",
            id="what cannot run is refused with its problems",
        ),
        pytest.param(
            (HEAD + OTHER).replace("As it comes.", "Else.").replace("goal: changing", "goal: changed"),
            ["first", "next"],
            "refused: .*goal",
            id="another goal",
        ),
    ],
)
def test_an_amendment_is_taken_or_refused_with_the_reason(amend, wanted, ran, change):
    report, goal, stage = amend(HEAD + WANTED, wanted)
    check_report(report, verdict="success", nodes=dict.fromkeys(ran, "done"))
    assert (get_order(stage), goal.asked, len(goal.changes)) == (ran, (), 1)
    assert re.match(change, goal.changes[0]), goal.changes


def test_a_node_that_cannot_be_done_may_be_taken_out_and_what_it_blocked_goes_on(amend):
    slow = """
      slow:%s
        skill: pick_and_place
        with: {object: yellow_cube, destination: blue_tray}
    accept: ["inside(blue_cube, blue_tray)"]
    """
    blocked = OTHER.replace("[first]", "[next]")
    old = HEAD + WANTED + blocked + slow % "\n        after: [{node: next, on: failure}]"
    again = WANTED.replace("next:", "again:") + OTHER.replace("[first]", "[again]") + slow % ""
    report, goal, _ = amend(old, HEAD + again, at="slow", script={"next": slip})
    assert goal.changes == ("as a person asked for",)
    nodes = dict.fromkeys(("first", "other", "slow", "again"), "done") | {"next": "skipped"}
    check_report(report, verdict="success", nodes=nodes)


def test_a_goal_goes_on_with_its_amended_graph_after_its_agent_has_died(make_stage, write_graph):
    stage = make_stage(world=two_in_red_tray())
    stage.runtime.script["each-red_cube"] = lambda world, session: (_ for _ in ()).throw(KeyboardInterrupt)
    mission = stage.make_mission()
    with pytest.raises(KeyboardInterrupt):
        mission.run(write_graph(HEAD + EACH % 2), seed=7)
    stage.runtime.script.clear()
    stage.runtime.on_change(None, None)
    report = stage.make_mission().resume(GoalId("changing-7"))
    assert (report.verdict, report.nodes["last"]) == ("success", "done")


def test_an_amendment_that_was_asked_for_without_an_agent_is_answered_by_the_next_one(make_stage, write_graph):
    stage = make_stage()
    stage.runtime.script["first"] = lambda world, session: (_ for _ in ()).throw(KeyboardInterrupt)
    with pytest.raises(KeyboardInterrupt):
        stage.pursue(write_graph(HEAD + WANTED))
    ask(stage, write_graph(HEAD + OTHER, "wanted.yaml"))
    stage.runtime.script.clear()
    report = stage.make_mission().resume(GoalId("changing-7"))
    check_report(report, nodes={"first": "done", "other": "done"})


def test_an_edit_of_the_task_document_that_cannot_be_read_is_kept_word_for_word(tmp_path, library, caplog):
    workspace, ledger = Workspace.create(tmp_path / "workspace", library), Ledger()
    with closing(TaskDocument(workspace, SystemClock())) as task:
        task.publish(ledger)
        torn = workspace.task.read_text().replace("view: 0", "view: {") + "what a person wrote\n"
        unknown = workspace.task.read_text().replace("view: 0", "view: 7") + "of another rendering\n"
        for text in (torn, unknown):
            workspace.task.write_text(text)
            assert task.is_touched()
            task.publish(ledger)
            assert task.take(at_once=True) == []
    kept = workspace.task.with_suffix(".rejected.md").read_text()
    assert (torn in kept, unknown in kept) == (True, True)
    assert caplog.text.count("TASK.rejected.md") == 2


@pytest.fixture
def edit_task(make_stage, write_graph):
    """Pursues a graph whose TASK.md a person edits before the first session runs."""

    def run(change):
        stage, clock = make_stage(), SystemClock()
        stage.runtime.paused = True
        with ThreadPoolExecutor(1) as pool:
            mission = stage.make_mission()
            ending = pool.submit(mission.run, write_graph(HEAD + WANTED), seed=7)
            until = clock.now_s() + 20.0
            while not (stage.workspace.task.is_file() and "state: active" in stage.workspace.task.read_text()):
                assert clock.now_s() < until
                clock.sleep(0.02)
            text = stage.workspace.task.read_text()
            stage.runtime.paused = False
            assert change(text) != text
            stage.workspace.task.write_text(change(text))
            report = ending.result(30.0)
        return report, mission.ledger.goals[GoalId("changing-7")], stage

    return run


def cut_node(text, name):
    """The YAML of a goal without one of its nodes."""
    return re.sub(rf"(?m)^  {name}:\n(?:    .*\n)+", "", text)


@pytest.mark.slow
def test_a_node_that_a_person_takes_out_of_the_task_document_is_not_done(edit_task):
    report, goal, stage = edit_task(lambda text: cut_node(text, "next"))
    check_report(report, verdict="success", nodes={"first": "done"}, sessions=[("first", "succeeded")])
    assert goal.changes == ("as a person asked for",)
    assert "**Changed:** as a person asked for" in stage.workspace.task.read_text()


@pytest.mark.slow
def test_what_a_person_wants_accepted_in_the_task_document_decides_the_goal(edit_task):
    wanted = "accept:\n- inside(red_cube, blue_tray)\nsubmitted_at"
    report, goal, _ = edit_task(lambda text: text.replace("submitted_at", wanted))
    assert goal.accept == ("inside(red_cube, blue_tray)",)
    assert (report.verdict, report.reason.partition(" is ")[0]) == ("failure", "inside(red_cube, blue_tray)")


@pytest.mark.slow
def test_a_state_that_a_person_writes_into_the_task_document_is_refused(edit_task):
    report, goal, _ = edit_task(lambda text: text.replace("state: active", "state: done"))
    check_report(report, verdict="success", sessions=[("first", "succeeded"), ("next", "succeeded")])
    assert goal.changes[0].startswith("refused: TASK.md: nodes.first cannot be changed there")


NODES = {f"n{index}": cube for index, cube in enumerate(("red", "green", "blue", "yellow"))}


def write_nodes(names, edges):
    sessions = {
        name: {
            "skill": "pick_and_place",
            "with": {"object": f"{NODES[name]}_cube", "destination": "red_tray"},
            "after": [before for before, after in edges if after == name and before in names],
        }
        for name in names
    }
    head = {"goal": "g", "objective": "o", "scene": "table", "targets": {"arm": "panda"}}
    return yaml.safe_dump(head | {"sessions": sessions})


EDGES = st.sets(st.sampled_from([(a, b) for a in NODES for b in NODES if a < b]))
NAMES = st.sets(st.sampled_from(sorted(NODES)), min_size=1)


@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(old=NAMES, new=NAMES, edges=EDGES, more=EDGES)
def test_a_goal_with_an_amended_graph_has_the_nodes_of_that_graph(catalogue, old, new, edges, more, tmp_path_factory):
    folder = tmp_path_factory.mktemp("graphs")
    graphs = []
    for name, names, given_edges in (("old", old, edges), ("new", new, more)):
        file = folder / f"{name}.yaml"
        file.write_text(write_nodes(sorted(names), given_edges))
        graphs.append(read_goal_graph(file, catalogue))
    ledger = Ledger()
    journal = Journal(folder, side=Side.AGENT, by="agent", clock=SystemClock(), durable=False)
    first, second = graphs
    nodes = {name: describe_node(first, name) for name in first.nodes}
    records = journal.commit(
        [Entry("goal:g-1", "goal_submitted", {}), Entry("goal:g-1", "goal_compiled", {"nodes": nodes})]
    )
    for record in records:
        ledger.apply(record)
    difference = compute_difference(second, ledger.goals[GoalId("g-1")].nodes)
    for record in journal.commit([Entry("goal:g-1", "goal_amended", difference)]):
        ledger.apply(record)
    journal.close()
    after = ledger.goals[GoalId("g-1")].nodes
    assert {name: (set(node.after), node.state) for name, node in after.items()} == {
        name: (set(node.after), NodeState.WAITING) for name, node in second.nodes.items()
    }
    assert set(difference["nodes"]) == {
        n for n in second.nodes if n not in first.nodes or describe_node(first, n) != describe_node(second, n)
    }


def test_a_fan_out_over_what_is_seen_has_no_session_before_it_is_ready(catalogue, write_graph):
    graph = read_goal_graph(write_graph(HEAD + EACH % 1), catalogue)
    compiler = SessionCompiler(graph=graph, catalogue=catalogue, goal=GoalId("changing-7"), seed=7)
    assert [session.node for session in compiler.preview()] == ["first", "last"]


def test_the_pristine_document_of_a_new_workspace_is_no_edit(tmp_path, library):
    workspace = Workspace.create(tmp_path / "workspace", library)
    workspace.task.write_text(Path("protocol/TASK.md").read_text())
    with closing(TaskDocument(workspace, SystemClock())) as task:
        ledger = Ledger()
        ledger.seq = 3  # something was recorded before anything is rendered
        task.publish(ledger)
        assert not task.take(at_once=True)
    assert not workspace.task.with_suffix(".rejected.md").exists()
