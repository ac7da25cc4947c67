"""Several runs behind one address: the list, the grid of a suite, the pages behind them, and what is not let in."""

import os
import re
import shutil
from threading import Event

import msgspec
import pytest

from phyagentos.bench.records import LOG, EpisodeRecord, Order
from phyagentos.bench.sweep import LOCK, MANIFEST, SUITE, Manifest
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.workspace.process_lock import WATCHDOG_LOCK, become_sole
from phyagentos.view import overview, places
from phyagentos.view.access import Access
from phyagentos.view.suites import CELLS_MAX, Standing, read_grid
from tests.view.conftest import GOAL, Desk, tell
from tests.view.test_page import HOST, OWN, SCENES, carry_token, see

pytest.importorskip("fastapi", reason="the extra `dev` brings it: make setup")
from fastapi.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from phyagentos.view.site import open_places

EVIL = "<img src=x onerror=alert(1)>"


@pytest.fixture
def access():
    return Access(frozenset({HOST}), frozenset({SCENES}))


@pytest.fixture
def ask(access):
    """Opens places; returns what answers GET requests with the token."""

    def start(*given, **options):
        client = TestClient(open_places(given, Event(), **options)(access), base_url=OWN, headers=carry_token(access))
        return client.get

    return start


@pytest.fixture
def folder(tmp_path, reported):
    """Two workspaces: one whose goal was replanned and met, and one in which nothing has run."""
    shutil.copytree(reported.workspace.root, tmp_path / "all" / "met")
    Desk(tmp_path / "all" / "below" / "empty").close()
    return tmp_path / "all"


def make_order(task, seed, **more):
    return Order(id=f"{task}.{seed}", task=task, seed=seed, graph="g", goal=f"{task}-{seed}", **more)


def make_record(order, **more):
    known = {"at": "2026-01-01T00:00:00Z", "folder": f"episodes/{order.id}-1", "verdict": "success", "is_met": True}
    return EpisodeRecord(id=order.id, task=order.task, seed=order.seed, **known | more)


def make_run(root, orders, records=(), missing=None):
    root.mkdir(parents=True)
    manifest = Manifest(source="s", project="p", at="a", orders=tuple(orders), missing=missing or {}, files={})
    (root / MANIFEST).write_bytes(msgspec.json.encode(manifest))
    (root / SUITE).write_text("suite: s\n")
    (root / LOG).write_bytes(b"".join(msgspec.json.encode(each) + b"\n" for each in records))
    return root


@pytest.fixture
def run(tmp_path, reported):
    """A run of eight episodes, each of which stands otherwise; the first one has a workspace."""
    orders = [make_order("lift", seed) for seed in range(9)]
    changes = [
        {}, {"replans": 1}, {"verdict": "failure", "is_met": False, "reason": EVIL}, {"is_met": False},
        {"verdict": "failure"}, {"is_met": None}, {"ended": "hung"},
    ]  # fmt: skip
    records = [make_record(order, **each) for order, each in zip(orders, changes, strict=False)]
    missing = {orders[8].id: (Problem("NOT_INSTALLED", "a", "no module"),)}
    root = make_run(tmp_path / "all" / "suite", orders, records, missing)
    shutil.copytree(reported.workspace.root, root / "episodes" / "lift.0-1" / "workspace")
    (root / "episodes" / "lift.7-1").mkdir()
    return root


def test_the_list_says_of_each_run_its_goal_its_verdict_and_what_it_took(ask, folder):
    page = ask(folder)("/")
    second, first = sorted(re.findall(r'<li class="run.*?</li>', page.text, re.DOTALL), key=lambda row: "Tidy" in row)
    assert "Tidy." in see(first)
    assert "2 sessions" in see(first)
    assert "open" in see(first)
    assert 'href="w/met/?goal=tidy-7"' in first
    assert "below/empty" in see(second)
    assert page.status_code == 200


def test_a_click_opens_the_page_of_a_workspace_which_leads_back(ask, folder):
    get = ask(folder)
    page = get("/w/met/?goal=tidy-7")
    assert "Tidy." in see(page.text)
    assert 'href="../../">All runs' in page.text
    for path in ("panels/story", "static/page.css", "evidence/tidy-7.a/trace.jsonl", "compare?first=a&second=b"):
        assert get(f"/w/met/{path}").status_code == (404 if "compare" in path else 200)


def test_what_runs_comes_first_whatever_was_written_later(ask, folder, tmp_path):
    later = Desk(folder / "later")
    tell(later)
    (folder / "later" / "LOG.md").touch()
    assert 'href="w/later/' in re.findall(r'<li class="run.*?</li>', ask(folder)("/").text, re.DOTALL)[0]
    lock = become_sole(folder / "met" / WATCHDOG_LOCK, SystemClock(), "BUSY", "held")
    try:
        first = re.findall(r'<li class="run.*?</li>', ask(folder)("/").text, re.DOTALL)[0]
    finally:
        os.close(lock)
        later.close()
    assert "w/met/" in first
    assert '"state running"' in first


def test_a_workspace_of_several_goals_begins_with_their_list_and_one_of_one_goal_with_its_page(ask, desk):
    tell(desk)
    assert "Timeline" in ask(desk.workspace.root)("/").text
    desk.record("goal:other-1", "goal_submitted", graph="other", seed=1, objective="Another one.")
    text = ask(desk.workspace.root)("/").text
    assert [words in see(text) for words in ("Another one.", "Tidy.", "Timeline")] == [True, True, False]


def test_the_grid_of_a_suite_shows_how_every_episode_stands(ask, run):
    place = places.find_places([run])["suite"]
    grid = read_grid(place)
    stands = [grid["rows"]["lift"][seed].standing for seed in range(9)]
    assert stands == [
        Standing.MET, Standing.AGAIN, Standing.FAILED, Standing.FALSE_SUCCESS, Standing.FALSE_FAILURE,
        Standing.UNSCORED, Standing.BROKEN, Standing.WAITING, Standing.MISSING,
    ]  # fmt: skip
    page = ask(run)("/").text
    assert EVIL not in page
    assert 'href="./e/suite/lift.0-1/"' in page
    assert "NOT_INSTALLED no module" in page
    assert "✓ 1 met" in see(page)
    assert "4 of 7 met" in see(page)
    assert "1 false success" in see(page)
    assert "2 are left" in see(page)
    left_open = page[page.index("Not met") :]
    assert [f"lift, seed {seed}" in left_open for seed in range(9)] == [seed in {2, 3, 5} for seed in range(9)]
    lock = become_sole(run / LOCK, SystemClock(), "BUSY", "held")
    try:
        assert read_grid(place)["rows"]["lift"][7].standing is Standing.RUNNING
    finally:
        os.close(lock)


def test_a_click_on_a_cell_opens_its_episode(ask, folder, run):
    get = ask(folder)
    assert 'href="../../e/suite/lift.0-1/"' in get("/suites/suite/").text
    page = get("/e/suite/lift.0-1/")
    assert "Tidy." in see(page.text)
    assert "lift.0-1" in see(page.text)
    assert 'href="../../../suites/suite/"' in page.text
    assert get("/suites/none/").status_code == 404


STRAY = (
    "/w/..%2f..%2fother/", "/w/%2e%2e/", "/w/%00/", "/w/none/", "/w/met", f"/w/{'a' * 5000}/", "/w//",
    "/w/outside/", "/w/suite/", "/e/met/lift.0-1/", "/e/suite/..%2f..%2fmet/", "/e/suite/%2e%2e/", "/e/suite/%00/",
    "/e/suite/linked/", "/e/suite/none/", "/e/none/x/", "/e/suite/", "/suites/met/", "/suites/..%2fsuite/",
    "/w/met/evidence/..%2F/TASK.md", "/w/met/evidence/tidy-7.a/..%2F..%2FTASK.md", "/none", "/none/x",
    "/compare/runs?first=..%2fmet&second=suite", "/scene/w~met~x/y/", "/scene/w/y/", "/scene/e~suite~..~x/y/",
)  # fmt: skip


def test_a_name_in_an_address_leads_nowhere_else(ask, folder, run, reported):
    (folder / "outside").symlink_to(reported.workspace.root)
    (run / "episodes" / "linked").symlink_to(run / "episodes" / "lift.0-1")
    get = ask(folder)
    answered = {path: get(path).status_code for path in STRAY}
    assert {path: code for path, code in answered.items() if code not in {401, 404}} == {}


@pytest.mark.slow
def test_hostile_names_goals_and_folders_of_episodes_stay_text(ask, folder, tmp_path):
    evil = Desk(folder / EVIL.replace("/", ""))
    evil.record(GOAL, "goal_submitted", graph="tidy", seed=7, objective=EVIL)
    evil.close()
    Desk(folder / os.fsdecode(b"bytes-\xff")).close()
    order = make_order(EVIL, 1)
    make_run(folder / "crafted", [order], [make_record(order, folder="../../met", reason=EVIL)])
    get = ask(folder)
    for path in ("/", "/suites/crafted/"):
        page = get(path)
        assert page.status_code == 200
        assert "<img src=x" not in page.text
        assert EVIL in see(page.text)
    (link,) = re.findall(r'href="(w/[^"]*)"[^>]*aria-label="&lt;img', get("/").text)
    assert EVIL in see(get(f"/{link}").text)
    assert get("/e/crafted/met/").status_code == 404


@pytest.mark.slow
def test_nothing_of_any_workspace_is_answered_without_the_token(access, folder, run):
    client = TestClient(open_places([folder], Event(), allows_actions=True)(access), base_url=OWN)
    for path in (
        "/",
        "/w/met/",
        "/w/met/events",
        "/e/suite/lift.0-1/",
        "/suites/suite/",
        "/w/none/",
        "/static/page.css",
    ):
        assert client.get(path).status_code == 401, path
        assert client.get(path, headers={"host": "elsewhere"}).status_code == 401
    assert client.post("/w/met/actions/estop", headers={"origin": OWN}).status_code == 401
    client.get("/w/met/", params={"token": access.token})  # the way of a browser in
    assert client.get(f"/{access.page_key}/w/met/").status_code == 200
    assert client.get("/w/met/").status_code == 401, "without the key of the page"


def test_the_scene_of_one_workspace_is_not_opened_by_the_key_of_another(access, folder, run, monkeypatch):
    monkeypatch.setattr("phyagentos.view.scenes._read_client", lambda: "the client of the scene")
    client = TestClient(open_places([folder], Event())(access), base_url=OWN, headers=carry_token(access))
    src = re.search(r'src="(http://[^"]*/scene/[^"]*)"', client.get("/w/met/?session=tidy-7.a").text)[1]
    assert "/scene/w~met~tidy-7.a/" in src
    there = {"host": SCENES}
    scene, key = src.rstrip("/").split("/")[-2:]
    for name, sent in ((scene, "0" * 32), ("w~below~tidy-7.a", key), ("e~suite~lift.0-1~tidy-7.a", key), (scene, key)):
        answer = client.get(f"/scene/{name}/{sent}/", headers=there)
        assert answer.status_code == (200 if (name, sent) == (scene, key) else 404)
    with pytest.raises(WebSocketDisconnect), client.websocket_connect(f"/scene/{scene}/{'0' * 32}", headers=there):
        pass


@pytest.mark.slow
def test_hundreds_of_workspaces_are_listed_in_pages(folder, ask, monkeypatch):
    for number in range(300):
        shutil.copytree(folder / "met" / "sessions", folder / f"w{number}" / "sessions")
        shutil.copy(folder / "met" / "workspace.yaml", folder / f"w{number}")
    read, ordinary = [], overview.read_ledger
    monkeypatch.setattr(overview, "read_ledger", lambda root: read.append(root) or ordinary(root))
    get = ask(folder)
    assert "302 places, page 2 of 6" in see(get("/?page=2").text)
    assert len(read) == overview.PAGE
    get("/?page=2")
    assert len(read) == overview.PAGE, "and again only once it has changed"
    assert get("/?page=6").text.count('<li class="run') == 2
    assert get("/?page=99").text.count('<li class="run') == 0
    assert get("/?page=-5").status_code == 200


def test_a_huge_folder_is_looked_through_only_so_far(tmp_path, monkeypatch):
    monkeypatch.setattr(places, "ENTRIES_MAX", 50)
    for number in range(200):
        (tmp_path / f"d{number}").mkdir()
        (tmp_path / f"d{number}" / "workspace.yaml").touch()
    assert len(places.find_places([tmp_path])) == 50
    monkeypatch.setattr(places, "FOUND_MAX", 7)
    assert len(places.find_places([tmp_path])) == 7


def test_a_huge_run_is_cut_and_files_that_are_too_large_or_links_are_not_read(tmp_path, ask, monkeypatch):
    root = make_run(tmp_path / "all" / "big", [make_order("lift", seed) for seed in range(CELLS_MAX + 3)])
    assert "3 more episodes are not shown" in see(ask(root)("/").text)
    with (root / LOG).open("ab") as file:
        file.truncate(400_000_000)
    get = ask(root)
    assert get("/").status_code == 404
    assert "at most" in see(get("/").text)
    (root / LOG).unlink()
    (root / LOG).symlink_to(tmp_path / "all" / "big" / MANIFEST)
    assert "only regular files" in see(get("/").text)


def test_a_damaged_workspace_is_named_in_the_list_and_the_others_stand(ask, folder):
    (segment,) = (folder / "met" / "sessions").glob("*/*.md")
    segment.write_text(segment.read_text().replace("goal_compiled", "goal_compi"))
    (folder / "below" / "empty" / "leads").symlink_to("/etc")
    text = see(ask(folder)("/").text)
    assert "JOURNAL_DAMAGED" in text or "met" in text
    assert "a link to /etc" in text


def test_a_folder_without_any_run_is_refused(tmp_path):
    (tmp_path / "none").mkdir()
    for path in (tmp_path / "none", tmp_path / "missing"):
        with pytest.raises(DefinitionError, match=r"NOT_A_WORKSPACE|no workspace"):
            open_places([path], Event())
