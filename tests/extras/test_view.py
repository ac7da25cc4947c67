"""The page in a real browser, over a session that is over: what it shows, and that anyone can use it."""

import json
import shlex
import shutil

import pytest

from phyagentos.clock import SystemClock
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.sessions.estop import is_latched, reset
from phyagentos.protocol.sessions.verdicts import Verdict
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.truth import Truth
from phyagentos.view.panels import PANELS
from tests.bench.suite_of_counter import call, make_project
from tests.extras.viewing import (
    Visits,
    await_picture,
    await_true,
    carry_out,
    differ,
    find_faults,
    find_wide,
    get_panel,
    get_scene,
    is_drawn,
    read_lines,
    served,
    shoot,
)
from tests.view.conftest import Desk

pytestmark = [pytest.mark.extras, pytest.mark.journey]

PARENT, CHILD = "tidy_table-7.red", "tidy_table-7.red.r1"
PAGES = {
    "page": f"/?session={CHILD}",
    "found": "/?find=blue",
    "compare": f"/compare?first={PARENT}&second={CHILD}",
    "runs": "/compare/runs?first=one&second=two",
    "problem": "/compare?first=none&second=none",
}
SEVERAL = {"list": "/", "grid": "/suites/one/", "opened": "/w/met/"}
ATTACK = "<script>window.hurt=1</script><img src=x onerror='window.hurt=2'>"
STREAMS = {"page", "found", "acting"}
SCENE = "#panel-scene iframe"  # the client of viser: not ours


@pytest.fixture(scope="module")
def runs(browser, tmp_path_factory):
    """Folders of two runs of a suite."""
    project = make_project(tmp_path_factory.mktemp("suite") / "p")
    for name in ("one", "two"):
        call(project, "run", "suite.yaml", "-r", name)
    return [project / "one", project / "two"]


@pytest.fixture(scope="module")
def shown(replanned, runs):
    """The server of the replanned session, read-only, with two runs to compare."""
    with served(replanned.root, *(f"--run={run}" for run in runs)) as server:
        yield server


@pytest.fixture(scope="module")
def several(replanned, runs, tmp_path_factory):
    """The server of a folder with the replanned workspace, one of hostile texts, and a run of a suite."""
    folder = tmp_path_factory.mktemp("several")
    shutil.copytree(replanned.root, folder / "met")
    shutil.copytree(runs[0], folder / "one")
    desk = Desk(folder / "hostile")
    desk.record("goal:tidy-7", "goal_submitted", graph="tidy", seed=7, objective=ATTACK)
    desk.close()
    with served(folder) as server:
        yield server


@pytest.fixture(scope="module")
def acting(replanned, tmp_path_factory):
    """The server of a copy of it, with actions; and the copy."""
    root = tmp_path_factory.mktemp("acting") / "w"
    shutil.copytree(replanned.root, root)
    with served(root, "--allow-actions") as server:
        yield server, Workspace.open(root)


@pytest.fixture(scope="module")
def page(browser, shown):
    """One page of the child, for tests that only read."""
    visits = Visits(browser)
    yield visits.open(shown, PAGES["page"])
    visits.end()


@pytest.fixture
def visit(request, visits):
    """Opens one of `PAGES` or `SEVERAL`, or `acting`: the page with its actions."""

    def open_one(name, **how):
        if name in SEVERAL:
            server = request.getfixturevalue("several")
            return visits.open(server, SEVERAL[name], awaits_stream=name == "opened", **how)
        if name == "acting":
            return visits.open(request.getfixturevalue("acting")[0], f"/?session={CHILD}", **how)
        return visits.open(request.getfixturevalue("shown"), PAGES[name], awaits_stream=name in STREAMS, **how)

    return open_one


def list_facts(workspace, panel):
    """What the documents of a panel say and, of that, what the command prints in the same words."""
    ledger = read_ledger(workspace.root)
    goal, child = ledger.goals["tidy_table-7"], ledger.sessions[CHILD]
    bundle = workspace.evidence_of(CHILD)
    criteria = [each.text for each in child.decision.criteria]
    match panel:
        case "runtime":
            return ["not running"], ["not running"]
        case "headline":
            return [goal.objective, goal.verdict, goal.reason, "4 sessions", "1 replan"], [goal.objective]
        case "timeline":
            names = [f"{id.removeprefix('tidy_table-7.')}" for id in ledger.sessions]
            return [*names, "panda", "replan", "GRASP_LOST"], [*names, "replan"]
        case "goal":
            steps = ["red", "red.r1", "green", "blue"]
            texts = [each.text for each in goal.criteria]
            return [*steps, *texts, PARENT], [goal.objective, *steps]
        case "sessions":
            return [*ledger.sessions, *{each.state for each in ledger.sessions.values()}], ["red.r1", "green", "done"]
        case "story":
            reasons = [each.because for each in child.decision.criteria]
            execution = [f"{child.execution.sim_time_s:.2f} s", "speed: 0.5"]
            return [child.state, child.decision.reason, *criteria, *reasons, *execution, PARENT], [*criteria, *reasons]
        case "distance":
            return ["inside(red_cube, red_tray)", "met above the limit", "limit 0 mm", "2 as perceived"], [*criteria]
        case "motion":
            return ["Joint positions", "joint 7", "Tracking error", "Gripper", "limit 80 mm"], []
        case "proposals":
            (name,) = (path.stem for path in (workspace.proposals / "new").iterdir())
            return [name, "again, please"], [name]
        case "memory":
            lessons = [line[3:] for line in workspace.lessons.read_text().splitlines() if line.startswith("## ")]
            assert lessons
            return lessons, lessons
        case "log":
            lines = [
                line[2:].replace("**", "")
                for line in workspace.log.read_text().splitlines()
                if line[:3] in {"- 0", "- 1", "- 2"}
            ]
            printed = (workspace.logs / "agent.log").read_text().split("\n")[0]
            return [*lines[-5:], printed], [printed]
        case "tree":
            names = {event["path"].rpartition("/")[2] for event in read_lines(bundle / "trace.jsonl")}
            return ["pick_and_place", "lower", *names], ["pick_and_place", "lower"]
        case "world":
            entities = json.loads((bundle / "environment_after.json").read_text())["entities"]
            place = " ".join(f"{x:.3f}" for x in entities["red_cube"]["pose"]["position_m"])
            return [*entities, place], ["red_cube", "green_tray"]
        case "frames":
            return ["overhead", "left", "right", "wrist"], ["equal to what was recorded", *criteria]
        case "statechart":
            chart = ["pending", "claimed", "preflight", "running", "halting", "succeeded"]
            return [*chart, "outcome unknown"], [*chart, "outcome_unknown"]
        case "scene":
            return [], []


SILENT = {"guard", "map", "questions"}  # it has not intervened, an arm has no map, and no criterion is for a person


def test_a_panel_that_has_nothing_to_show_is_absent(page):
    for name in SILENT:
        assert get_panel(page, name).evaluate("each => getComputedStyle(each).display") == "none"


@pytest.mark.parametrize("panel", [each for each in PANELS if each.name not in SILENT], ids=lambda panel: panel.name)
def test_a_panel_says_what_its_documents_say_and_names_their_file_and_the_command(panel, replanned, page, tmp_path):
    inside = get_panel(page, panel.name)
    said, printed = list_facts(replanned, panel.name)
    text = squeeze(inside.text_content())
    assert not [words for words in said if squeeze(words) not in text], text
    assert (replanned.root / inside.locator(".source .file").text_content()).exists()
    name, *command = shlex.split(inside.locator(".source code").text_content())
    assert name == "paos"
    out = carry_out(*command, *(("--to", tmp_path / "picture.png") if panel.name in {"scene", "motion"} else ()))
    assert not [words for words in printed if words not in out], out


def squeeze(text):
    return " ".join(text.split())


def test_frames_are_the_pictures_that_perception_has_used(visits, shown, replanned):
    page = visits.open(shown, PAGES["page"])  # its own: once the cursor moves, a page shows those of a moment alone
    looks = json.loads((replanned.evidence_of(CHILD) / "looks.json").read_text())
    pictures = get_panel(page, "frames").locator("img")
    pictures.first.scroll_into_view_if_needed()
    pictures.last.scroll_into_view_if_needed()
    await_true(page, "[...document.querySelectorAll('#panel-frames img')].every(each => each.naturalWidth > 0)")
    assert pictures.count() >= 2 * len({"overhead", "left", "right", "wrist"}), looks
    assert get_panel(page, "frames").get_by_text("sees bottle, red_cube").count()
    assert get_panel(page, "frames").locator("rect").count() > pictures.count()


def test_a_replay_shows_any_moment_of_the_evidence(shown, visits):
    page = visits.open(shown, PAGES["page"], with_scene=True)
    picture = page.locator(".flat img").first
    picture.wait_for()  # in place of the scene, until that is drawn
    get_scene(page)
    assert not picture.is_visible()
    slider = page.locator("#panel-scene input.cursor")
    first = await_picture(page, is_drawn, "a drawn scene")
    shoot(page, "replay_begin", whole=False)
    for key in ("End", "Home"):
        slider.press(key)
        if key == "End":
            last = await_picture(page, lambda picture: differ(picture, first) > 0.004, "another picture")
            shoot(page, "replay_end", whole=False)
    await_picture(page, lambda picture: differ(picture, first) < differ(last, first) / 4, "the first picture")
    page.get_by_label("paths", exact=True).uncheck()
    bare = await_picture(page, lambda picture: differ(picture, first) > 0.0005, "no paths")
    page.get_by_label("cameras", exact=True).check()
    await_picture(page, lambda picture: differ(picture, bare) > 0.004, "what the cameras saw")
    shoot(page, "replay_cameras", whole=False)


def test_a_narrow_scene_shows_no_controls_of_its_own(browser, shown):
    visits = Visits(browser)
    page = visits.open(shown, PAGES["page"], with_scene=True, width=1024)
    scene = get_scene(page)
    assert scene.get_by_text("Connected").count() == 1, "its client has them"
    assert not scene.get_by_text("Connected").is_visible()
    wide = page.locator(".stage").bounding_box()["width"]
    assert page.locator(".stage iframe").bounding_box()["width"] == pytest.approx(wide, abs=1)
    assert scene.evaluate("innerWidth") == pytest.approx(wide / 2, abs=1), "the processor draws a quarter of the points"
    visits.end()


def test_one_cursor_moves_scene_plots_and_log_and_plays_by_itself(page, shown, visits):
    page.locator("#moment").press("Home")
    page.locator("#moment").press("PageUp")
    await_true(page, "document.querySelectorAll('.log li.now').length === 1")
    assert page.locator("#panel-scene input.cursor").input_value() == page.locator("#moment").input_value() != "0"
    assert page.locator("svg.plot > line.cursor[visibility=visible]").count() == page.locator("svg.plot").count()
    curves = page.locator("#panel-motion svg.plot polyline").count()
    assert page.locator("#panel-motion output.at:not(:empty)").count() == curves > 5, "each curve says its value there"
    before = float(page.locator("#moment").input_value())
    page.locator("#play").click()
    await_true(page, f"Number(document.querySelector('#moment').value) > {before + 5}")
    page.get_by_role("button", name="Pause").click()


def test_without_webgl_the_pictures_stand_in_place_of_the_scene(browser, shown):
    visits = Visits(browser)
    page = visits.open(shown, awaits_stream=False)
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    page.goto(shown.origin + PAGES["page"])
    page.locator(".flat figure img").first.wait_for()
    page.locator("#panel-scene input.cursor").press("End")
    await_true(page, "document.querySelector('.flat figure.now img').alt === 'The world after the session'")
    page.locator("#panel-scene input.cursor").fill("500")
    drawn = "document.querySelector('.flat figure.now[data-drawn] img')"
    await_true(page, f"{drawn}?.naturalWidth === 800")  # a picture of that moment, drawn from the evidence
    middle = page.evaluate(f"{drawn}.src")
    page.locator("#panel-scene input.cursor").fill("900")
    await_true(page, f"{drawn}?.naturalWidth === 800 && {drawn}.src !== '{middle}'")
    assert not page.locator("#panel-scene iframe").is_visible()
    shoot(page, "flat")
    visits.end()


def test_two_sessions_stand_side_by_side_with_what_differed(visit):
    page = visit("compare")
    text = squeeze(page.locator("main").text_content())
    for words in (
        PARENT,
        CHILD,
        "replanned",
        "succeeded",
        "strategy",
        "yaw+000",
        "GRASP_LOST",
        "joint path",
        " mm from its tightest bound",
    ):
        assert words in text
    assert page.locator("svg.chart polyline").count() == 2 * page.locator("svg.chart").count() > 8
    shoot(page, "compare")


def test_two_runs_of_a_suite_stand_side_by_side(visit):
    page = visit("runs")
    text = squeeze(page.locator("main").text_content())
    assert "one: 2/2" in text or "Gained 0, lost 0" in text
    assert page.locator("tbody tr").count() >= 1
    shoot(page, "runs")


def test_a_click_in_the_list_opens_a_run_and_one_in_the_grid_an_episode(visit):
    page = visit("list")
    assert ATTACK in page.locator("main").text_content()
    assert page.evaluate("window.hurt") is None
    await_true(page, "document.querySelector('.run img').naturalWidth > 0")
    page.get_by_role("link", name="tray of its colour").click()
    page.wait_for_url("**/w/met/?goal=tidy_table-7")
    assert "1 replan" in squeeze(get_panel(page, "headline").text_content())
    page.get_by_role("link", name="All runs").click()
    page.get_by_role("link", name="Does it count?, one").click()
    page.locator("a.cell").first.click()
    page.wait_for_url("**/e/one/**")
    assert "Three steps up." in get_panel(page, "headline").text_content()


@pytest.mark.parametrize("name", [*PAGES, *SEVERAL, "acting"])
def test_axe_finds_nothing(name, visit, axe):
    page = visit(name)
    for each in page.locator("details").all():
        each.evaluate("each => { each.open = true }")
    shoot(page, f"whole_{name}")
    assert find_faults(page, axe, without=[SCENE]) == []


@pytest.mark.parametrize("name", [*PAGES, *SEVERAL, "acting"])
def test_on_a_narrow_screen_only_what_scrolls_is_wider_than_it(name, visit):
    page = visit(name, width=360, height=740)
    shoot(page, f"narrow_{name}", whole=False)
    for each in page.locator("details").all():
        each.evaluate("each => { each.open = true }")
    assert find_wide(page) == []
    if name == "acting":
        page.mouse.wheel(0, 2000)
        await_true(page, "scrollY > 500")
        stop = page.locator("button.stop").bounding_box()
        assert stop["y"] >= 0
        assert stop["y"] + stop["height"] <= 740, "it stays in sight"
        header = page.locator("header").bounding_box()
        assert header["height"] < 740 / 3, "and leaves room"
        shoot(page, "narrow_scrolled", whole=False)


def test_a_person_answers_a_question_and_contests_a_verdict(browser, visits, tmp_path):
    desk = Desk(tmp_path / "w")
    place, goal = desk.workspace, "goal:tidy-7"
    desk.record(goal, "goal_submitted", graph="tidy", seed=7, objective="Tidy.")
    nodes = {"a": {"objective": "Put it away.", "skill": "pick_and_place", "target": "panda"}}
    desk.record(goal, "goal_compiled", nodes=nodes, accept=["human: Is the table clean?"], constraints=[])
    place.goal_file_of("tidy-7").write_text("goal: tidy\n")
    first = desk.submit("a")
    desk.execute(first)
    desk.judge(first, Verdict.SUCCESS, Truth.TRUE)
    desk.record(goal, "goal_verdict", verdict="success", criteria=[], reason="all is done")
    desk.close()
    with served(place.root, "--allow-actions") as server:
        page = visits.open(server)
        shoot(page, "question")
        get_panel(page, "questions").get_by_role("button", name="Yes").click()
        page.locator("#result").get_by_text("paos answer tidy-7 yes").wait_for()
        await_true(page, "getComputedStyle(document.querySelector('#panel-questions')).display === 'none'")
        get_panel(page, "story").get_by_text("The verdict is wrong").click()
        reason = page.get_by_label("What you see instead")
        reason.fill("It leans on the wall.")
        shoot(page, "contest", whole=False)
        page.get_by_role("button", name="Contest").click()
        get_panel(page, "story").get_by_text("It leans on the wall.").first.wait_for()
        shoot(page, "contested")
    assert read_ledger(place.root).sessions[first].attempts[-1].is_review
    assert len([*place.answers_of("tidy-7").iterdir()]) == 1


def press_tab_until(page, is_there, limit=60):
    """Go on from focus to focus, each of which is seen, until one is there."""
    for _ in range(limit):
        page.keyboard.press("Tab")
        seen = page.evaluate(
            """() => { const at = document.activeElement, style = getComputedStyle(at);
              const box = at.getBoundingClientRect();
              return {name: at.tagName + ' ' + (at.textContent || at.name || ''), is_frame: at.tagName === 'IFRAME',
                ring: style.outlineStyle !== 'none' && parseFloat(style.outlineWidth) >= 2,
                inside: box.bottom > 0 && box.top < innerHeight && box.right > 0 && box.left < innerWidth}; }"""
        )
        assert seen["is_frame"] or (seen["ring"] and seen["inside"]), f"focus is not seen: {seen}"
        if page.evaluate(f"document.activeElement.matches({json.dumps(is_there)})"):
            return
    raise AssertionError(f"{is_there} is not reached")


def test_the_keyboard_alone_finds_a_session_and_presses_the_stop(acting, visits):
    server, workspace = acting
    page = visits.open(server)
    press_tab_until(page, ".skip", 1)
    shoot(page, "keyboard_skip", whole=False)
    page.keyboard.press("Enter")
    assert page.evaluate("document.activeElement.id") == "panels"
    page.reload()
    press_tab_until(page, "input[name=find]")
    page.keyboard.type("red")
    page.keyboard.press("Enter")
    page.wait_for_url("**find=red**")
    press_tab_until(page, f"a.bar[href*='session={CHILD}']")
    page.keyboard.press("Enter")
    page.wait_for_url(f"**session={CHILD}**")
    assert CHILD in get_panel(page, "story").text_content()
    press_tab_until(page, "button.stop")
    shoot(page, "keyboard_stop", whole=False)
    page.keyboard.press("Enter")
    try:
        page.locator("#result").get_by_text("The emergency stop is latched").wait_for()
        assert "kind: estop" in page.locator("#result").text_content()
        assert is_latched(workspace.signals.parent)
    finally:
        reset(workspace.signals.parent, "the test is over", SystemClock())
