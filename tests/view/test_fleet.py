"""The page over a whole fleet: who is there, who holds what, and the stop that only its own form may press."""

from threading import Event

import msgspec
import pytest

from phyagentos.fleet.bus import Bucket, Claim, HostCard, Offer, encode_key, get_offer_key
from phyagentos.operations import fleet
from phyagentos.testing import ManualClock, make_contract
from phyagentos.view.access import FORM_HEADER, Access
from tests.fleet.fake_bus import FakeBus, FakeServer
from tests.view.conftest import HOSTILE
from tests.view.test_page import HOST, OWN, SCENES, carry_token

pytest.importorskip("fastapi", reason="the extra `dev` brings it: make setup")
from fastapi.testclient import TestClient

from phyagentos.view.site import open_places


@pytest.fixture
def server():
    server = FakeServer()
    for name, more in {"bench-1": {"page": "https://bench-1:8000/"}, "bench.2": {"is_stopped": True}}.items():
        card = HostCard(host=name, targets={"panda": ("pick", HOSTILE)}, load=1, **more)
        server.write(Bucket.HOSTS, encode_key(name), msgspec.json.encode(card), name)
    forged = HostCard(host="bench-1", targets={"of_another": ()})
    server.write(Bucket.HOSTS, "bench-3", msgspec.json.encode(forged), "bench-3")
    for number, id in enumerate(("g.held", "g.waits")):
        offer = Offer(contract=make_contract(id=id, objective=HOSTILE), number=number, revision=1, lease_s=15.0)
        server.write(Bucket.OFFERS, get_offer_key(offer.contract), msgspec.json.encode(offer))
    claim = Claim(host="bench-1", epoch=1, lease_s=15.0, beat=3)  # it says so
    server.write(Bucket.CLAIMS, encode_key("g.held"), msgspec.json.encode(claim), "bench.2")
    return server


@pytest.fixture
def watch(server):
    return fleet.FleetWatch(FakeBus(server), "nats://secret@10.0.0.1:4222")


@pytest.fixture
def access():
    return Access(frozenset({HOST}), frozenset({SCENES}))


@pytest.fixture
def visit(access, documents, watch):
    def start(root=documents.workspace.root, **options):
        app = open_places([root], Event(), **({"fleet": watch} | options))(access)
        return TestClient(app, base_url=OWN, headers=carry_token(access))

    return start


def test_the_page_shows_hosts_and_who_holds_what_by_their_own_subjects(visit, watch):
    shown = visit().get("/fleet/").text
    assert 'href="https://bench-1:8000/"' in shown
    assert "of_another" not in shown
    assert "<td>bench.2</td>" in shown
    assert "<td>bench-1</td>" not in shown
    assert "waits for a host" in shown
    assert "15 s, 3 renewals" in shown
    assert "secret" not in shown
    assert HOSTILE not in shown
    assert "panda <span" in shown
    assert "STOP EVERY HOST" not in shown
    states = {each.card.host: each.is_alive for each in watch.read().hosts}
    assert states == {"bench-1": True, "bench.2": True}


def test_a_host_that_beats_no_more_is_silent(server):
    watch = fleet.FleetWatch(FakeBus(server), "")
    watch._clock = clock = ManualClock(1e6)
    watch.read()
    clock.advance(fleet.SILENCE_S + 1.0)
    server.write(Bucket.HOSTS, "bench-1", server.values[Bucket.HOSTS]["bench-1"].value, "bench-1")
    assert {each.card.host: each.is_alive for each in watch.read().hosts} == {"bench-1": True, "bench.2": False}


@pytest.mark.parametrize("has_list", [True, False])
def test_the_page_is_found_where_there_is_a_fleet(visit, documents, tmp_path, has_list):
    root = documents.workspace.root.parent if has_list else documents.workspace.root
    assert 'href="fleet/"' in visit(root).get("/").text
    assert visit(root).get("/fleet/").status_code == 200
    assert 'href="fleet/"' not in visit(root, fleet=None).get("/").text
    assert visit(root, fleet=None).get("/fleet/").status_code == 404


def test_the_stop_for_all_is_pressed_from_the_page_alone_and_says_who_did_not_answer(
    visit, server, access, monkeypatch
):
    monkeypatch.setattr(fleet, "ANSWER_S", 0.0)
    origin = {"origin": OWN}
    assert visit().post("/fleet/stop", headers={FORM_HEADER: access.form_secret, **origin}).status_code >= 404
    page = visit(allows_actions=True)
    assert access.form_secret in page.get("/fleet/").text
    assert page.post("/fleet/stop", headers=origin).status_code == 403
    assert not server.values[Bucket.STOPS]
    answered = page.post("/fleet/stop", headers={FORM_HEADER: access.form_secret, **origin})
    assert (answered.status_code, "No answer from bench-1" in answered.text) == (422, True)
    assert b"pressed on the page" in server.values[Bucket.STOPS]["stop"].value
    assert "latest stop for all" in page.get("/fleet/").text
