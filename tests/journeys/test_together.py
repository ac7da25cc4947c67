"""Two arms in one world under one goal: each around the other, one for the other, and from hand to hand."""

import json
import shutil
from contextlib import contextmanager

import msgspec
import numpy as np
import pytest

from phyagentos.assembly.agent_plane import MemoryUse
from phyagentos.assembly.paths import open_project
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.world.environment import Environment
from phyagentos.store.journal import Journal

pytestmark = pytest.mark.journey

SEIZED = "version: 1\nfaults:\n  - {kind: stall, joint: joint1, when: {session: 'one_tray*.red'}, duration_s: 3600}\n"
ONE_TRAY = """
goal: one_tray
objective: Both arms bring a cube into the tray that both reach.
scene: shared_table
targets: {left: left_arm, right: right_arm}
worlds: {table: [left, right]}
defaults: {timeout_s: 60, max_replans: 2}
sessions:
  red:
    skill: pick_and_place
    target: left
    with: {object: red_1, destination: green_tray}
    accept: ["inside(red_1, green_tray)"]
    resources: [green_tray]
  blue:
    skill: pick_and_place
    target: right
    with: {object: blue_1, destination: green_tray}
    accept: ["inside(blue_1, green_tray)"]
    resources: [green_tray]
  away:
    skill: home
    target: right
    after: [blue]
    accept: ["inside(blue_1, green_tray)"]
    even_if_met: true
"""


@contextmanager
def open_table(root):
    """A project that is the example, served; a function that pursues a goal: its report, and the journal's records."""
    project = root / "project"
    shutil.copytree(find_shipped_root() / "examples" / "projects" / "04_two_arms", project)
    (project / "goal_graphs" / "one_tray.yaml").write_text(ONE_TRAY)
    (faults := root / "faults.yaml").write_text(SEIZED)
    workspace, clock = open_project(root / "w", project), SystemClock()
    with open_bench(workspace, clock, faults=faults, memory_use=MemoryUse.NONE) as agent:

        def pursue(graph):
            report = agent.mission.run(project / "goal_graphs" / f"{graph}.yaml", seed=1)
            journal = Journal(workspace.root, side=Side.OPERATOR, by="test", clock=clock)
            records = [record for record in journal.read_new() if graph in record.id]
            journal.close()
            return workspace, report, records

        yield pursue


@pytest.fixture(scope="module")
def pursue(tmp_path_factory):
    """One warm table for all goals."""
    with open_table(tmp_path_factory.mktemp("table")) as pursue:
        yield pursue


def list_events(workspace, report):
    for session in report.sessions:
        file = workspace.evidence_of(session.id) / "events.jsonl"
        yield from map(json.loads, file.read_text().splitlines() if file.exists() else ())


def test_where_one_arm_is_disabled_in_the_middle_of_a_goal_the_other_one_finishes_it(pursue):
    workspace, report, records = pursue("one_tray")
    submitted = {record.id: record.body for record in records if record.ev == "submit"}
    red = [body for id, body in submitted.items() if ".red" in id]

    assert report.verdict == "success", report
    assert [body["target"] for body in red] == ["left_arm", "left_arm", "right_arm"]
    children = [record.body for record in records if record.ev == "child_of"]
    assert "on right_arm instead of left_arm" in children[-1]["reason"].partition("rather than")[0], children
    assert [each.cause for each in report.sessions if each.node == "red"] == ["STALLED", "STALLED", ""]
    assert not [event for event in list_events(workspace, report) if event["kind"] == "robot_contact"]


def find_spans(records):
    """(start, finish) of each session, by their places in the journal."""
    places = {(record.id, record.ev): at for at, record in enumerate(records)}
    return {id: (at, places[id, "finish"]) for (id, ev), at in places.items() if ev == "start"}


def test_two_arms_sort_one_heap_at_once_and_take_turns_at_the_tray_that_both_reach(pursue):
    workspace, report, records = pursue("sort_together")
    spans = find_spans(records)
    folders = [workspace.evidence_of(session.id) for session in report.sessions]

    assert report.verdict == "success", report
    assert not [event for event in list_events(workspace, report) if event["kind"] == "robot_contact"]
    red, green_2, green_1 = (spans[f"{report.goal}.{node}"] for node in ("red_1", "green_2", "green_1"))
    assert max(red[0], green_2[0]) < min(red[1], green_2[1])  # at once
    assert green_2[1] < green_1[0]  # in turn
    busy_s = sum(session.sim_time_s for session in report.sessions)
    ends = [float(np.load(folder / "terminal.npz")["time"]) for folder in folders]
    assert max(ends) - min(float(np.load(folder / "initial.npz")["time"]) for folder in folders) < 0.7 * busy_s


def test_both_cubes_are_put_away_at_once_and_another_run_has_the_same_bits_whatever_ran_before(pursue, tmp_path, paos):
    with open_table(tmp_path) as pursue_again:
        (workspace, report, _), (_, again, _) = runs = pursue("two_arms"), pursue_again("two_arms")
    files = [sorted(found.evidence_of(each.id).glob("*.npz")) for found, ended, _ in runs for each in ended.sessions]

    assert (report.verdict, again.verdict) == ("success", "success")
    assert {file.name for file in files[0]} >= {"trajectory.npz", "terminal.npz", "initial.npz"}
    red, blue, *others = [{file.name: file.read_bytes() for file in each} for each in files]
    assert red["initial.npz"] == blue["initial.npz"], "both sessions began in one state of one world"
    assert [red, blue] == others
    refused = paos("rerun", report.sessions[0].id, "--workspace", workspace.root)
    assert (refused.code > 0, "WORLD_CONFLICT" in refused.err) == (True, True)


def test_a_bar_goes_from_hand_to_hand_in_the_air(pursue):
    workspace, report, _ = pursue("handover")

    assert report.verdict == "success", report
    files = [workspace.evidence_of(session.id) / "environment_after.json" for session in report.sessions]
    worlds = [msgspec.json.decode(file.read_bytes(), type=Environment) for file in files]
    hands = [{name for name, state in world.targets.items() if "bar" in state.holding} for world in worlds]
    assert hands == [{"left_arm"}, {"left_arm"}, {"left_arm", "right_arm"}, {"right_arm"}, set()]
    assert all(world.entities["bar"].pose.position_m[2] > 0.25 for world in worlds[1:4])
    assert not [event for event in list_events(workspace, report) if event["kind"] == "robot_contact"]
