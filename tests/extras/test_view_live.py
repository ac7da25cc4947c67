"""The page in a real browser while a robot moves: a run followed from its start to its verdict, and the stop."""

import contextlib

import pytest

from phyagentos.clock import SystemClock
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.estop import is_latched, read_latch
from phyagentos.protocol.sessions.heartbeats import find_heartbeat
from phyagentos.protocol.sessions.stop_signals import Signal, drop_signal
from phyagentos.protocol.workspace.workspace import Workspace
from tests.extras.viewing import (
    PATIENCE_S,
    ROOT,
    await_picture,
    await_true,
    differ,
    get_panel,
    get_scene,
    is_drawn,
    served,
    shoot,
    start,
)
from tests.following import wait_until

pytestmark = [pytest.mark.extras, pytest.mark.journey]

CLOCK = SystemClock()
GOAL = "goal_graphs/tidy_table.yaml"
WATCH = """() => {  // keep what the page has shown, however short it was there
  window.seen = {states: new Set(), trees: new Set(), ticked: new Set(), scenes: new Set()};
  const look = () => {
    for (const row of document.querySelectorAll('#panel-sessions tbody tr')) {
      seen.states.add(row.querySelector('a').textContent + ' ' + row.querySelector('.state').textContent); }
    const marks = [...document.querySelectorAll('#panel-tree .tree li')].map(each => each.classList[0]);
    seen.trees.add(marks.join(' '));
    marks.forEach(each => seen.ticked.add(each));
    const frame = document.querySelector('#panel-scene iframe');
    if (frame) seen.scenes.add(frame.title);
  };
  new MutationObserver(look).observe(document.getElementById('panels'), {subtree: true, childList: true,
    characterData: true, attributes: true});
  look();
}"""
SEEN = "Object.fromEntries(Object.entries(window.seen).map(([name, each]) => [name, [...each]]))"


@pytest.fixture
def workspace(browser, tmp_path):
    """One in which nothing has happened yet."""
    return Workspace.create(tmp_path / "w", Library.open(ROOT))


@contextlib.contextmanager
def running(workspace, *options):
    """`paos run` of a goal in a process of its own, on physics."""
    with (workspace.root / "said.txt").open("w") as said:
        words = ("run", GOAL, "--seed", 7, "--memory", "none", "--no-pictures", "-w", workspace.root, *options)
        process = start(*words, stdout=said, stderr=said)
        try:
            yield process
        finally:
            process.terminate()
            process.wait(60)


def is_moving(workspace):
    beat = find_heartbeat(workspace.heartbeats, "panda")
    return beat is not None and beat.session and beat.tick > 10 and beat.phase == "executing"


def is_in_phase(workspace, phase):
    beat = find_heartbeat(workspace.heartbeats, "panda")
    return beat is not None and beat.phase == phase


def get_time_s(workspace):
    return find_heartbeat(workspace.heartbeats, "panda").sim_time_s


def pause(workspace):
    """Let the session rest at the end of its present motion."""
    drop_signal(workspace.signals, Signal(kind="pause", by="test"), CLOCK)
    wait_until(lambda: is_in_phase(workspace, "paused"), "a pause", PATIENCE_S)


def resume(workspace):
    drop_signal(workspace.signals, Signal(kind="resume", by="test"), CLOCK)
    wait_until(lambda: not is_in_phase(workspace, "paused"), "the end of a pause", PATIENCE_S)


def test_a_run_is_followed_from_its_start_to_its_verdict_without_a_reload(workspace, visits):
    with served(workspace.root) as server:
        page = visits.open(server, with_scene=True)
        assert "not running" in get_panel(page, "runtime").text_content()
        assert "No goal has been submitted" in get_panel(page, "headline").text_content()
        page.evaluate(WATCH)
        with running(workspace, "--faults", "faults/slip.yaml") as run:
            wait_until(lambda: is_moving(workspace) or run.poll() is not None, "a robot that moves", PATIENCE_S)
            pause(workspace)  # it rests until its picture is there
            get_panel(page, "runtime").get_by_text("paused").wait_for()
            get_scene(page)
            beside = visits.open(server, "/?session=tidy_table-7.red")  # does not go on to the next session
            beside.evaluate(WATCH)
            resting = await_picture(page, is_drawn, "a scene of the running session")
            shoot(page, "live_paused", whole=False)
            rested_s = get_time_s(workspace)
            while get_time_s(workspace) < rested_s + 1.0:  # down to the cube, and up with it
                resume(workspace)
                pause(workspace)
            await_picture(page, lambda one: is_drawn(one) and differ(one, resting) > 0.002, "a robot that has moved on")
            shoot(page, "live_moved", whole=False)
            assert page.locator("#panel-scene iframe").get_attribute("title") == "3D scene of tidy_table-7.red"
            resume(workspace)
            goal = get_panel(page, "headline").locator("p .state.success")
            goal.wait_for()
            assert run.wait(PATIENCE_S) == 0
        get_panel(page, "runtime").get_by_text("not running").wait_for()
        await_picture(page, is_drawn, "the scene of the last session")
        shoot(page, "live_over")
        seen = page.evaluate(SEEN)
        get_panel(beside, "tree").locator("li.failure").get_by_text("GRASP_LOST").first.wait_for()
        seen_beside = beside.evaluate(SEEN)
    sessions = read_ledger(workspace.root).sessions
    assert len(sessions) == 4
    assert {"tidy_table-7.red running", "tidy_table-7.red replanned"} <= set(seen["states"])
    assert {f"{id} {each.state}" for id, each in sessions.items()} <= set(seen["states"])
    assert {"success", "running"} <= set(seen["ticked"])
    assert {"success", "running", "failure"} <= set(seen_beside["ticked"])
    assert len(seen["trees"]) > 5, "the tree has ticked"
    assert {f"3D scene of {id}" for id in sessions} >= set(seen["scenes"]) > set()


def test_one_press_of_the_stop_ends_the_session_and_its_reset_asks_for_a_reason(workspace, visits):
    signals = workspace.signals.parent
    with served(workspace.root, "--allow-actions") as server:
        page = visits.open(server)
        with running(workspace, "--world-mode", "realtime") as run:
            wait_until(lambda: is_moving(workspace) or run.poll() is not None, "a robot that moves", PATIENCE_S)
            assert run.poll() is None, (workspace.root / "said.txt").read_text()
            page.get_by_role("button", name="EMERGENCY STOP").click()
            page.locator("#result").get_by_text("The emergency stop is latched").wait_for()
            assert "kind: estop" in page.locator("#result").text_content()
            assert read_latch(signals).by.startswith("page")
            wait_until(lambda: not is_moving(workspace), "a robot that rests", PATIENCE_S)
            wait_until(lambda: list_ended(workspace), "the end of the session", PATIENCE_S)
            get_panel(page, "runtime").get_by_text("emergency stop").wait_for()
            (ended,) = list_ended(workspace)
            assert ended.execution.ended != "completed"
            row = get_panel(page, "sessions").locator("tr").filter(has_text=ended.contract.id).last
            row.locator(".state:not(.running):not(.halting)").wait_for()
            shoot(page, "stopped")
            page.get_by_text("Reset the emergency stop").click()
            page.get_by_role("button", name="Reset").click()
            reason = page.get_by_label("Why it is safe to move again")
            assert reason.evaluate("each => each.validity.valueMissing"), "the browser asks for it"
            reason.fill("   ")
            page.get_by_role("button", name="Reset").click()
            page.locator("#result .problem").get_by_text("MISSING_VALUE").wait_for()
            assert is_latched(signals), "and so does the server"
            shoot(page, "reset_refused", whole=False)
            reason.fill("the table is free")
            page.get_by_role("button", name="Reset").click()
            page.locator("#result").get_by_text("The emergency stop is reset").wait_for()
            assert "kind: reset" in page.locator("#result").text_content()
            assert not is_latched(signals)
            await_true(page, "!document.querySelector('#panel-runtime').textContent.includes('emergency stop')")


def list_ended(workspace):
    return [each for each in read_ledger(workspace.root).sessions.values() if each.execution is not None]
