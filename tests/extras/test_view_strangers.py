"""The page in a real browser: hostile texts, pages of others, a thousand nodes, and a connection that drops."""

import contextlib
import http.client
import http.server
import json
import signal
import subprocess
import threading
from urllib.parse import quote

import pytest

from phyagentos.agent.tools.proposals import Proposal, Proposals, encode_proposal
from phyagentos.protocol.sessions.estop import Latch, is_latched, latch
from phyagentos.protocol.sessions.verdicts import Verdict
from phyagentos.protocol.world.truth import Truth
from tests.extras.viewing import await_live, await_true, get_panel, read_lines, serve, served, shoot
from tests.view.conftest import GOAL, Desk

pytestmark = [pytest.mark.extras, pytest.mark.journey]

SAVED_MS = 20_000  # a page that the browser saves does not arrive
ATTACK = "<script>window.hurt=1</script><img src=x onerror='window.hurt=2'>\"'><svg onload=window.hurt=3>"
MANY, REFRESH_S = 1000, 0.2
EVIL_PAGE = """<!doctype html><title>other</title>
<form method=post action="{origin}/actions/estop" target=answer><input name=reason value=x></form>
<iframe name=answer></iframe><iframe id=framed src="{origin}/"></iframe>
<script>
const tried = [];
document.forms[0].submit();
const post = {{method: "POST", mode: "no-cors", credentials: "include"}};
tried.push(fetch("{origin}/actions/estop", post).then(() => 0, () => 0));
tried.push(fetch("{origin}/", {{credentials: "include"}}).then(answer => answer.text(), () => ""));
tried.push(new Promise(done => {{ const socket = new WebSocket("{socket}/scene/tidy-7.a");
  socket.onopen = () => done("open"); socket.onclose = () => done("closed"); }}));
Promise.all(tried).then(found => {{ window.found = found; }});
</script>"""


@pytest.fixture
def desk(browser, tmp_path):
    made = Desk(tmp_path / "w")
    yield made
    made.close()


def submit_goal(desk, nodes, objective="Tidy."):
    desk.record(GOAL, "goal_submitted", graph="tidy", seed=7, objective=objective)
    desk.record(GOAL, "goal_compiled", nodes=nodes, accept=[], constraints=[])


def make_node(objective, *after):
    return {"objective": objective, "skill": "pick_and_place", "target": "panda", "after": [*after]}


@pytest.fixture
def hostile(desk):
    """A workspace whose every text is an attack, and what of it each panel has to show."""
    place = desk.workspace
    submit_goal(desk, {"a": make_node(ATTACK), "b": make_node(ATTACK, "a")}, objective=ATTACK)
    first = desk.submit("a")
    desk.execute(first, events=[{"time_s": 1.0, "kind": "intervention", "code": "X", "details": {"message": ATTACK}}])
    folder = place.evidence_of(first)
    for name in ("environment_before.json", "environment_after.json"):
        world = json.loads((folder / name).read_text())
        (folder / name).write_text(json.dumps(world | {"scene": ATTACK}))
    events = [event | {"message": ATTACK} for event in read_lines(folder / "trace.jsonl")]
    (folder / "trace.jsonl").write_text("".join(json.dumps(event) + "\n" for event in events))
    (folder / "evil.html").write_text(f"<!doctype html><script src=evil.js></script>{ATTACK}")
    (folder / "evil.svg").write_text("<svg xmlns='http://www.w3.org/2000/svg'><script>window.hurt=4</script></svg>")
    (folder / "evil.js").write_text("window.hurt = 5")
    desk.judge(first, Verdict.REPLAN, Truth.FALSE, cause=ATTACK)
    desk.submit("a", 1, parent=first)
    place.log.write_text(f"- 07:00:00 {ATTACK}\n")
    (place.logs / "agent.log").write_text(f"{ATTACK}\n")
    facts = {"by": ATTACK[:80], "at": "2026-01-01", "reason": ATTACK, "graph": {"objective": ATTACK}}
    Proposals(place.proposals).put(encode_proposal(Proposal(goal="tidy", seed=1, **facts)))
    latch(place.signals.parent, Latch(by=ATTACK, reason=ATTACK))
    return first


def test_texts_of_documents_are_shown_and_no_script_of_theirs_runs(hostile, desk, visits):
    with served(desk.workspace.root, "--allow-actions") as server:
        page = visits.open(server, f"/?session={hostile}", with_scene=True)
        for name in ("headline", "runtime", "goal", "story", "guard", "log", "tree", "world"):
            assert ATTACK in get_panel(page, name).text_content(), name
        assert "window.hurt=1" in get_panel(page, "proposals").text_content()
        page.evaluate("document.querySelectorAll('details').forEach(each => { each.open = true })")
        shoot(page, "hostile")
        assert page.evaluate("window.hurt") is None
        await_true(page, "document.querySelector('#panel-scene iframe').contentDocument === null")  # each apart
        assert page.evaluate("document.querySelectorAll('main script, main img[src=x], svg[onload]').length") == 0
        for path in (
            f"/?find={quote(ATTACK)}&session={quote(ATTACK)}&goal={quote(ATTACK)}",
            f"/compare?first={quote(ATTACK)}&second={hostile}",
            f"/compare/runs?first={quote(ATTACK)}",
            f"/panels/{quote(ATTACK, safe='')}",
            f"/scene/{quote(ATTACK, safe='')}/",
        ):
            page.goto(server.origin + path)
            assert page.evaluate("window.hurt") is None, path
        for name in ("evil.html", "evil.svg"):
            with contextlib.suppress(Exception):  # it may be saved instead of shown
                page.goto(f"{server.origin}/evidence/{hostile}/{name}", timeout=SAVED_MS)
            page.wait_for_timeout(200)
            assert page.evaluate("window.hurt") is None, name


def test_a_page_of_others_in_the_same_browser_neither_acts_nor_reads(desk, visits):
    submit_goal(desk, {"a": make_node("Put it away.")})
    desk.submit("a")
    with served(desk.workspace.root, "--allow-actions") as server, other_page(server) as address:
        page = visits.open(server)
        visits.allowed.append(address.removeprefix("http://"))
        page.goto(address)  # another port of the same host: the browser sends the cookie along
        await_true(page, "window.found")
        _, read, scene = page.evaluate("window.found")
        assert (read, scene) == ("", "closed")
        answers = [frame for frame in page.frames if frame.url.startswith(server.origin)]
        texts = " ".join(frame.text_content("body") or "" for frame in answers)
        assert "EMERGENCY" not in texts
    assert not is_latched(desk.workspace.signals.parent)


@contextlib.contextmanager
def other_page(server):
    """A web server beside ours, whose page attacks ours."""
    text = EVIL_PAGE.format(origin=server.origin, socket=server.origin.replace("http", "ws", 1)).encode()

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("content-type", "text/html")
            self.end_headers()
            self.wfile.write(text)

        def log_message(self, *_):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as other:
        threading.Thread(target=other.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{other.server_port}"
        other.shutdown()


def test_a_connection_that_drops_is_said_and_found_again(desk, visits):
    submit_goal(desk, {"a": make_node("Put it away.")})
    token = "t" * 32
    server = serve(desk.workspace.root, token=token)
    try:
        page = visits.open(server)
        page.evaluate("window.mark = 1")
        server.end(kills=True)
        page.locator("#connection.lost").wait_for()
        assert "lost" in page.locator("#connection").text_content()
        shoot(page, "dropped", whole=False)
        latch(desk.workspace.signals.parent, Latch(by="test", reason="while nobody looked"))
        server = serve(desk.workspace.root, "--port", server.port, token=token)
        await_live(page)
        get_panel(page, "runtime").get_by_text("while nobody looked").wait_for()
        assert page.evaluate("window.mark") == 1, "without a reload"
    finally:
        server.end()


def test_ctrl_c_ends_a_server_whose_page_is_open_without_an_error(desk, visits):
    submit_goal(desk, {"a": make_node("Put it away.")})
    server = serve(desk.workspace.root, stderr=subprocess.PIPE)
    page = visits.open(server)
    server.process.send_signal(signal.SIGINT)
    _, err = server.process.communicate(timeout=60)
    assert "Traceback" not in err
    assert "ERROR" not in err, err
    page.locator("#connection.lost").wait_for()
