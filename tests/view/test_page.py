"""The page: what its panels show, for whom, and that documents stay data."""

import asyncio
import html
import json
import os
import re
from contextlib import aclosing
from threading import Event

import numpy as np
import pytest

from phyagentos.agent.tools.proposals import Proposal, Proposals, encode_proposal
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.estop import is_latched
from phyagentos.protocol.sessions.evidence import SCENE_MODEL
from phyagentos.protocol.sessions.heartbeats import Heartbeat, write_heartbeat
from phyagentos.protocol.sessions.verdicts import Verdict
from phyagentos.protocol.workspace.array_files import encode_arrays
from phyagentos.protocol.workspace.process_lock import WATCHDOG_LOCK, become_sole
from phyagentos.protocol.world.truth import Truth
from phyagentos.view.access import FORM_HEADER, Access
from phyagentos.view.archive import build_archive
from phyagentos.view.comparison import compare_sessions
from phyagentos.view.documents import Documents
from phyagentos.view.pages import NOTHING, PanelRenderer
from phyagentos.view.panels import PANELS, Place, Query
from tests.looks import keep_look
from tests.view.conftest import GOAL, HOSTILE

pytest.importorskip("fastapi", reason="the extra `dev` brings it: make setup")
from fastapi.testclient import TestClient
from starlette.requests import Request
from starlette.websockets import WebSocketDisconnect

from phyagentos.view import server
from phyagentos.view.server import build_app

HOST = "127.0.0.1:8000"
OWN = f"http://{HOST}"
SCENES = "127.0.0.1:8001"


@pytest.fixture
def access():
    return Access(frozenset({HOST}), frozenset({SCENES}))


def carry_token(access):
    return {"authorization": f"Bearer {access.token}"}


@pytest.fixture
def open_page(reported, access):
    clients = []

    def start(**options):
        client = TestClient(build_app(reported, access, **options), base_url=OWN, headers=carry_token(access))
        clients.append(client.__enter__())
        return client

    yield start
    for client in clients:
        client.__exit__(None, None, None)


def read(documents, panel, **query):
    renderer = PanelRenderer(documents, lambda: {"actions": False, "live": True})
    return renderer.render(next(each for each in PANELS if each.name == panel), Query(**query))


def see(text):
    """What a person reads of HTML."""
    return " ".join(html.unescape(re.sub(r"<(style|title)[^>]*>.*?</\1>|<[^>]+>", " ", text, flags=re.DOTALL)).split())


@pytest.mark.parametrize("panel", PANELS, ids=lambda panel: panel.name)
def test_every_panel_names_its_file_and_the_command_that_prints_the_same(reported, panel):
    shown = see(read(reported, panel.name, session="tidy-7.a"))
    if panel.name in {
        "distance",
        "frames",
        "map",
        "questions",
        "proposals",
        "memory",
        "log",
    }:  # they have nothing to show
        assert read(reported, panel.name, session="tidy-7.a") == NOTHING
        return
    assert panel.title in shown
    assert panel.file.format(id="tidy-7.a") in shown
    names = {"w": reported.given, "id": "tidy-7.a", "skill": "pick_and_place"}
    assert panel.command.format(**names) in shown


@pytest.mark.parametrize(
    ("panel", "said"),
    [
        ("headline", ["Tidy.", "2 sessions 1 replan"]),
        ("goal", ["tidy-7.a → tidy-7.a.r1"]),
        ("sessions", ["tidy-7.a.r1 succeeded"]),
        (
            "statechart",
            ["pending → claimed → preflight → running → halting → awaiting verification → verifying → replanned"],
        ),
        ("guard", ["JOINT_ACCELERATION too fast"]),
        ("story", ["replan GRASP_LOST", "Continued by tidy-7.a.r1"]),
        ("world", ["red_cube 0.300 0.000 0.020 seen 2.5 s 50 %"]),
    ],
)
def test_panels_say_what_the_documents_say(reported, panel, said):
    shown = see(read(reported, panel, session="tidy-7.a"))
    assert [words for words in said if words not in shown] == []


def test_frames_show_where_objects_were_seen_in_them(documents, access):
    folder = documents.workspace.evidence_of("tidy-7.a")
    keep_look(folder, "start", {"top": b"PNG", "left": b"PNG"}, time_s=0.5)
    world = json.loads((folder / "environment_before.json").read_text())
    cube = world["entities"]["red_cube"]
    cube["evidence"] = ["top@0.500:91,47,9,8", "left@0.400:1,2,3,4", "left@0.500:1,2,<b>", "top"]
    (folder / "environment_before.json").write_text(json.dumps(world))
    top, left = read(documents, "frames", session="tidy-7.a").split("<figure")[1:]
    assert '<rect x="91" y="47" width="9" height="8"><title>red_cube</title></rect>' in top
    assert "top 0.50 s (start) sees red_cube" in see(top)
    assert "<rect" not in left
    with TestClient(build_app(documents, access), base_url=OWN, headers=carry_token(access)) as client:
        assert client.get(re.search(r'src="([^"]+)"', top)[1]).content == b"PNG"
        assert client.get("/frames/tidy-7.a/look-start.zip/other.png").status_code == 404


def test_a_tree_shows_each_nodes_status_its_ports_and_the_last_one_before_a_reset(reported):
    tree = read(reported, "tree", session="tidy-7.a")
    rows = [see(row) for row in tree.split("<li")]
    failed = next(row for row in rows if "▣ pick " in row and "GRASP_LOST" in row)
    assert "✗" in failed
    reset = next(row for row in rows if "close_gripper" in row and "↺" in row)
    assert "was SUCCESS" in reset
    assert any("object = $object" in row for row in rows)


def test_without_a_choice_the_page_follows_the_session_that_runs(documents, desk):
    third = desk.submit("b")
    documents.refresh()
    assert documents.find_session().contract.id == third
    assert "pending" in see(read(documents, "story"))


def test_texts_of_told_are_shown_and_never_run(reported):
    for panel in PANELS:
        assert "<script" not in read(reported, panel.name, session="tidy-7.a")
    assert HOSTILE in see(read(reported, "headline"))
    assert "<script" not in build_archive(reported, reported.find_goal())


@pytest.mark.parametrize(
    ("damaged", "panel", "said"),
    [(("trace.jsonl",), "tree", "trace"), (("scene.mjb", "motion.npz"), "distance", "scene.mjb")],
)
def test_damaged_evidence_is_named_in_its_panel_and_the_others_stand(documents, damaged, panel, said):
    for name in damaged:
        (documents.workspace.evidence_of("tidy-7.a") / name).write_text("{")
    shown = read(documents, panel, session="tidy-7.a")
    assert ('role="alert"' in shown, said in see(shown)) == (True, True)
    assert "EVIDENCE_DAMAGED" in see(read(documents, "story", session="tidy-7.a"))
    assert "Tidy." in see(read(documents, "headline", session="tidy-7.a"))


def test_a_comparison_shows_what_differs_and_nothing_else(reported):
    found = compare_sessions(reported, "tidy-7.a", "tidy-7.a.r1")
    assert [row[0] for row in found["parameters"]] == ["seed"]
    assert [[each.truth for each in row[1:]] for row in found["criteria"]] == [["false", "true"]]
    assert found["moved"] == [["red_cube moved 0.200 m, seen"], ["red_cube moved 0.320 m, seen"]]
    assert len(found["charts"]) == 8


def test_an_archive_needs_no_server(reported):
    page = build_archive(reported, reported.find_goal())
    assert not re.search(r"(src|href)=\"(?!data:|#)", page)
    assert page.count('id="session-') == 2


def test_a_thousand_nodes_are_collapsed_by_state_and_found_by_name(desk):
    from phyagentos.view.documents import Documents

    nodes = {f"n{n}": {"objective": f"Do {n}.", "after": [f"n{n - 7}"] if n >= 7 else []} for n in range(1000)}
    desk.record("goal:big-1", "goal_submitted", graph="big", seed=1, objective="Much.")
    desk.record("goal:big-1", "goal_compiled", nodes=nodes, accept=[], constraints=[])
    documents = Documents(desk.workspace.root)
    documents.refresh()
    boxes = re.findall(r"(\d+) waiting", see(read(documents, "goal")))
    assert sum(map(int, boxes)) == 1000
    assert len(boxes) < 20
    assert "n777" in see(read(documents, "goal", find="n777"))


def test_nothing_is_answered_without_the_token_or_under_another_name(open_page, access):
    client = open_page()
    assert client.get("/").status_code == 200
    assert client.get("/", headers={"host": "elsewhere.example:8000"}).status_code == 401
    del client.headers["authorization"]
    for path in ("/", "/events", "/panels/goal", "/static/page.css", "/evidence/tidy-7.a/trace.jsonl"):
        assert client.get(path).status_code == 401
    assert client.get("/", params={"token": "guessed"}).status_code == 401
    entered = client.get("/", params={"token": access.token}, follow_redirects=False)
    assert (entered.status_code, entered.headers["location"]) == (303, f"/{access.page_key}/")
    assert "HttpOnly" in entered.headers["set-cookie"]
    assert access.token not in client.get("/", headers={"authorization": f"Bearer {access.token}"}).text


def test_a_moment_that_cannot_be_drawn_is_said_and_hides_nothing_else(open_page):
    client = open_page()
    for path in ("/moments/unknown/0", "/moments/tidy-7.a/0", "/moments/tidy-7.a/99", "/moments/..%2f..%2fetc/0"):
        assert client.get(path).status_code == 404
    assert "data-drawn" not in client.get("/").text  # its evidence holds no motion
    del client.headers["authorization"]
    assert client.get("/moments/tidy-7.a/0").status_code == 401


def test_a_panel_of_one_session_is_drawn_anew_with_the_records_of_that_alone(documents, desk):
    first = desk.submit("b")
    documents.refresh()
    renderer = PanelRenderer(documents, lambda: {"actions": False, "live": True})
    panel = next(each for each in PANELS if each.name == "statechart")
    before = renderer.render(panel, Query(session=first))
    desk.submit("c")
    documents.refresh()
    assert renderer.render(panel, Query(session=first)) is before
    desk.execute(first)
    documents.refresh()
    assert renderer.render(panel, Query(session=first)) != before


def test_the_stream_sends_each_panel_at_first(open_page):
    client = open_page()
    got = []
    with client.stream("GET", "/events") as stream:
        for line in stream.iter_lines():
            got += [line.removeprefix("event: ")] if line.startswith("event: ") and line != "event: pulse" else []
            if len(got) == len(PANELS):
                break
    assert got == [panel.name for panel in PANELS]


def test_what_left_no_compiled_scene_has_no_panel_of_it(documents):
    assert read(documents, "scene", session="tidy-7.a") != NOTHING
    (documents.workspace.evidence_of("tidy-7.a") / SCENE_MODEL).unlink()
    assert read(documents, "scene", session="tidy-7.a") == NOTHING


def test_a_heartbeat_is_sent_as_data_and_renders_no_panel(documents, monkeypatch):
    drawn = []
    monkeypatch.setattr(PanelRenderer, "render", lambda _, panel, __: drawn.append(panel.name) or "")
    monkeypatch.setattr(server, "LOOK_PERIOD_S", 60.0)
    beat = Heartbeat(target="panda", pid=1, session="tidy-7.a", phase="executing", leaf="pick", sim_time_s=1.5)

    async def is_there():
        return {"type": "http.request"}

    async def follow():
        feed = server.PanelFeed(PanelRenderer(documents))
        request, watcher = Request({"type": "http"}, is_there), server.Watcher(documents, Event())
        async with aclosing(server.iter_changes(request, feed, watcher, Query())) as events:
            while not drawn:
                await anext(events)
            drawn.clear()
            write_heartbeat(documents.workspace.heartbeats, beat)
            return await anext(events)

    lock = become_sole(documents.workspace.root / WATCHDOG_LOCK, SystemClock(), "BUSY", "held")
    try:
        event = asyncio.run(follow())
    finally:
        os.close(lock)
    data = event.removeprefix("event: pulse\ndata: ")
    assert json.loads(data) == [["panda", "tidy-7.a", "executing", "pick", 1.5]]
    assert drawn == []


def test_a_read_only_page_has_no_actions(open_page):
    client = open_page()
    assert "EMERGENCY" not in client.get("/").text
    assert client.post("/actions/estop", headers={"origin": OWN}).status_code == 404


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"origin": OWN},
        {"origin": "http://elsewhere.example", FORM_HEADER: "secret"},
        {FORM_HEADER: "secret"},
        {"origin": OWN, FORM_HEADER: "guessed"},
    ],
)
def test_an_action_that_is_not_from_our_own_page_is_refused(open_page, access, reported, headers):
    sent = {name: access.form_secret if value == "secret" else value for name, value in headers.items()}
    refused = open_page(allows_actions=True).post("/actions/estop", headers=sent)
    assert refused.status_code == 403
    assert not is_latched(reported.workspace.signals.parent)


def test_the_stop_waits_for_no_thread_that_other_actions_hold(documents, access, monkeypatch):
    async def wait_for_ever(*_):
        raise AssertionError("a thread was asked for")

    app = build_app(documents, access, allows_actions=True)
    client = TestClient(app, base_url=OWN, headers=carry_token(access))
    monkeypatch.setattr("phyagentos.view.server.asyncio.to_thread", wait_for_ever)
    pressed = client.post("/actions/estop", headers={"origin": OWN, FORM_HEADER: access.form_secret})
    assert pressed.status_code == 200
    assert is_latched(documents.workspace.signals.parent)


def enter(client, access):
    """The way of a browser in by the printed address; its cookies."""
    del client.headers["authorization"]
    client.get("/", params={"token": access.token}, follow_redirects=False)
    return dict(client.cookies)


def test_a_cookie_alone_opens_nothing_and_two_servers_do_not_share_its_name(open_page, access, reported):
    client = open_page(allows_actions=True)
    ((name, value),) = enter(client, access).items()
    assert (HOST.rpartition(":")[2] in name, access.token in value, access.page_key in value) == (True, False, False)
    inside = f"/{access.page_key}"
    assert client.get(f"{inside}/").status_code == client.get(f"{inside}/panels/goal").status_code == 200
    stolen = {FORM_HEADER: access.form_secret, "origin": OWN}
    for path in ("/", "/panels/goal", "/events", "/evidence/tidy-7.a/trace.jsonl", f"/{'0' * 32}/"):
        refused = client.get(path)
        assert (refused.status_code, access.form_secret in refused.text) == (401, False)
    assert client.post("/actions/estop", headers=stolen).status_code == 401
    client.cookies.clear()
    assert client.get(f"{inside}/").status_code == 401, "nor does the address"
    assert client.post(f"{inside}/actions/estop", headers=stolen).status_code == 401
    assert not is_latched(reported.workspace.signals.parent)


def test_no_answer_lets_a_script_in_or_is_kept_and_the_scene_has_an_origin_of_its_own(open_page, access):
    client = open_page(allows_actions=True)
    scene = access.scene_address("tidy-7.a")
    assert scene.startswith(f"http://{SCENES}/")
    assert f'src="{scene}"' in client.get("/?session=tidy-7.a").text
    assert client.get("/", headers={"host": SCENES}).status_code == 401
    for path in (
        "/",
        "/panels/goal",
        "/compare?first=a&second=b",
        "/evidence/tidy-7.a/trace.jsonl",
        "/none",
        "/static/page.js",
    ):
        answer = client.get(path)
        assert "unsafe" not in answer.headers["content-security-policy"], path
        assert answer.headers["cache-control"] == "no-store", path
    for host, session in ((SCENES, "tidy-7.a.r1"), (HOST, "tidy-7.a"), ("elsewhere:8001", "tidy-7.a")):
        path = f"/scene/tidy-7.a/{access.scene_key(session)}/"
        assert client.get(path, headers={"host": host}).status_code == 401


@pytest.mark.parametrize("origin", ["http://elsewhere.example", "", "null", OWN, f"http://{SCENES}.elsewhere.example"])
def test_the_socket_of_a_scene_asks_for_origin_host_and_key(open_page, access, origin):
    client, key = open_page(), access.scene_key("tidy-7.a")
    own = {"origin": f"http://{SCENES}", "host": SCENES}
    others = {name: access.scene_key(name) for name in ("tidy-7.a.r1", "")}
    for path, headers in (
        (f"/scene/tidy-7.a/{key}/viewer", own | {"origin": origin}),
        (f"/scene/tidy-7.a/{key[:-1]}/viewer", own),
        (f"/scene/tidy-7.a/{others['tidy-7.a.r1']}/viewer", own),
        (f"/scene/tidy-7.a/{others['']}/viewer", own),
        (f"/scene/tidy-7.a/{access.token}/viewer", own),
        (f"/scene/tidy-7.a/{key}/viewer", own | {"host": HOST}),
        (f"/scene/tidy-7.a/{key}/viewer", own | {"host": "elsewhere:8001"}),
        (f"/scene/tidy-7.a/{key}/viewer", {"host": SCENES}),
    ):
        with pytest.raises(WebSocketDisconnect) as refused, client.websocket_connect(path, headers=headers):
            pass
        assert refused.value.code == 1008, path


def test_the_socket_of_a_scene_opens_for_its_own_frame(open_page, access, monkeypatch):
    class Staged:
        def __init__(self, _documents, session):
            raise ValueError(f"no scene of {session}")

    monkeypatch.setattr("phyagentos.view.scenes.Stage", Staged)
    path, own = f"/scene/tidy-7.a/{access.scene_key('tidy-7.a')}/viewer", {"origin": f"http://{SCENES}", "host": SCENES}
    with open_page().websocket_connect(path, headers=own) as opened, pytest.raises(WebSocketDisconnect) as ended:
        opened.receive_bytes()
    assert (ended.value.code, ended.value.reason) == (1011, "no scene of tidy-7.a")


@pytest.mark.parametrize(
    ("sent", "status"),
    [
        (b'{"time_s": 1.5, "cameras": true}', 204), (b'{"time_s": "x"}', 404), (b'{"other": 1}', 404), (b"[1", 404),
        (b'{"time_s": 1' + b"0" * 5000 + b"}", 404),
    ],
)  # fmt: skip
def test_a_scene_is_directed_by_its_own_frame_alone_and_only_to_a_moment(open_page, access, monkeypatch, sent, status):
    stage = type("Scene", (), {"control": None})()
    monkeypatch.setattr("phyagentos.view.scenes.STAGES", {"viewer": stage})
    client, key = open_page(), access.scene_key("tidy-7.a")
    path, own = f"/scene/tidy-7.a/{key}/viewer/control", {"origin": f"http://{SCENES}", "host": SCENES}
    assert client.post(path, content=sent, headers=own).status_code == status
    assert (stage.control is not None) == (status == 204)
    if status == 204:
        assert (stage.control.time_s, stage.control.cameras, stage.control.paths) == (1.5, True, True)
        assert client.post(path.replace("viewer", "other"), content=sent, headers=own).status_code == 404
        for headers in (own | {"origin": OWN}, own | {"host": HOST}, own | {"origin": "http://elsewhere.example"}):
            assert client.post(path, content=sent, headers=headers).status_code == 401
        wrong = path.replace(key, "0" * 32)
        assert client.post(wrong, content=sent, headers=own).status_code == 401


@pytest.mark.parametrize(
    "path",
    [
        "/evidence/tidy-7.a/%00", "/evidence/%00/x", f"/evidence/{'a' * 300}/x", "/frames/tidy-7.a/trace.jsonl/x.png",
        "/frames/tidy-7.a/%00/x", f"/panels/{'a' * 5000}", "/compare?first=%00&second=",
        "/compare/runs?first=a&second=b",
        "/static/%00", "/static/..%2Faccess.py", "/scene/x/y/z/none", "/actions/estop",
        "/evidence/..%2F/TASK.md", "/evidence/tidy-7.a/..%2F..%2FTASK.md", "/evidence/./TASK.md", "/evidence/x/y",

    ],
)  # fmt: skip
def test_what_is_not_there_is_not_found(open_page, path):
    assert open_page().get(path).status_code == 404


def test_evidence_that_lacks_its_parts_is_compared_as_far_as_it_goes(documents, access):
    folder = documents.workspace.evidence_of("tidy-7.a")
    (folder / "trajectory.npz").write_bytes(encode_arrays({"time_s": np.zeros(3), "q_measured": np.zeros(2)}))
    client = TestClient(build_app(documents, access), base_url=OWN, headers=carry_token(access))
    assert client.get("/compare?first=tidy-7.a&second=tidy-7.a.r1").status_code == 404


def test_a_form_has_a_bound(open_page, access):
    sent = {"origin": OWN, FORM_HEADER: access.form_secret}
    answer = open_page(allows_actions=True).post("/actions/lint", headers=sent, data={"graph": "x" * (1 << 21)})
    assert answer.status_code == 413


def put_proposal(documents, **changed):
    facts = {"by": "mcp", "at": "2026-01-01T00:00:00Z", "graph": {"goal": "tidy"}} | changed
    proposed = encode_proposal(Proposal(goal="tidy", seed=5, **facts))
    Proposals(documents.workspace.proposals).put(proposed)
    return proposed


def test_a_proposal_is_shown_by_its_own_bytes_and_no_other_hides_it(documents, tmp_path):
    new = documents.workspace.proposals / "new"
    large = put_proposal(documents, graph={"goal": "tidy", "objective": "y" * 200_000})
    small = put_proposal(documents, graph={"goal": "tidy", "objective": "zz"})
    changed = put_proposal(documents, graph={"goal": "tidy", "objective": "before"})
    (new / f"{changed.name}.yaml").write_bytes(changed.data.replace(b"before", b"after"))
    (tmp_path / "other.yaml").write_text("objective: of another file\n")
    (new / f"tidy-{'0' * 16}.yaml").symlink_to(tmp_path / "other.yaml")
    (new / f"tidy-{'1' * 16}.yaml").write_bytes(b"x" * (1 << 20))
    renderer = PanelRenderer(documents, lambda: {"actions": True, "live": True})
    shown = renderer.render(next(each for each in PANELS if each.name == "proposals"), Query())
    assert re.findall(r'name="sha256" value="(\w+)"', shown) == [large.sha256, small.sha256]
    assert small.data.decode() in html.unescape(shown)
    assert "objective: after" not in shown
    assert "of another file" not in shown
    assert shown.count("CHANGED") + shown.count("UNREADABLE_FILE") == 2


@pytest.mark.slow
def test_many_large_proposals_and_files_that_are_none_hide_no_small_one(documents):
    for number in range(5):
        put_proposal(documents, graph={"goal": "tidy", "objective": f"{number}" + "y" * 250_000})
    small = put_proposal(documents, graph={"goal": "tidy", "objective": "zz"})
    for number in range(300):
        (documents.workspace.proposals / "new" / f"x{number}.txt").touch()
    shown = read(documents, "proposals")
    assert html.unescape(shown).count(small.data.decode()) == 1
    assert "200 more files wait" in see(shown)
    assert len(shown) < 3_000_000


def test_what_waits_for_a_person_is_said_in_the_first_lines_and_asked_above_the_timeline(desk, access):
    node = {"objective": "Put it away.", "skill": "pick_and_place", "target": "panda"}
    desk.record(GOAL, "goal_submitted", graph="tidy", seed=7, objective="Tidy.")
    desk.record(GOAL, "goal_compiled", nodes={"a": node}, accept=["human: Is it clean?"], constraints=[])
    session = desk.submit("a")
    desk.execute(session)
    desk.judge(session, Verdict.SUCCESS, Truth.TRUE)
    desk.record("node:tidy-7/a", "node_done")
    documents = Documents(desk.workspace.root)
    documents.refresh()
    put_proposal(documents)

    assert "open waits for your answer" in see(read(documents, "headline"))
    assert "1 proposal to decide" in see(read(documents, "runtime"))
    names = [panel.name for panel in PANELS if panel.place is Place.TOP]
    assert names.index("questions") < names.index("timeline")
    client = TestClient(build_app(documents, access, allows_actions=True), base_url=OWN, headers=carry_token(access))
    page = client.get("/").text
    assert page.index("Is it clean?") < page.index('<svg class="timeline"')
    assert 'hx-post="actions/deny"' in page
    sent = {"origin": OWN, FORM_HEADER: access.form_secret}
    answered = client.post("/actions/answer", headers=sent, data={"subject": "tidy-7", "says": "no", "question": "1"})
    assert (answered.status_code, "Your answer is recorded: no." in see(answered.text)) == (200, True), answered.text


def test_a_document_of_400_mb_stops_no_panel_and_a_link_is_not_followed(documents, tmp_path):
    place = documents.workspace
    (tmp_path / "secret.txt").write_text("of another folder\n")
    (place.logs / "linked.log").symlink_to(tmp_path / "secret.txt")
    for path in (place.log, place.lessons, place.environment, place.evidence_of("tidy-7.a") / "trace.jsonl"):
        with path.open("ab") as file:
            file.truncate(400_000_000)
            file.seek(0, 2)
            file.write(b"\n- 07:00:00 the last line\n")
    assert "the last line" in see(read(documents, "log"))
    assert "of another folder" not in see(read(documents, "log"))
    for name, code in (("memory", "bytes"), ("tree", "EVIDENCE_DAMAGED")):
        assert code in see(read(documents, name, session="tidy-7.a"))
    assert "Tidy." in see(read(documents, "headline"))


def test_the_graph_of_a_goal_shows_of_each_session_its_skill_its_time_and_what_it_left(reported):
    svg = read(reported, "goal")
    first = reported.workspace.evidence_of("tidy-7.a")
    (first / "after.png").write_bytes(b"a picture")

    assert "<image" not in svg
    assert 'href="evidence/tidy-7.a/after.png"' in read(reported, "goal")
    assert "pick_and_place" in see(read(reported, "goal"))
    assert "3.9 s" in see(svg)
