"""The port of a fleet over a real NATS server, which is killed meanwhile; a session from hub to host and back."""

import asyncio
import contextlib
import itertools
import json
import math
import os
import subprocess
from contextlib import closing

import msgspec
import pytest

from benchmarks.fleet_parts.links import Link
from benchmarks.fleet_parts.noop import sum_up, time_fleet
from benchmarks.fleet_parts.stage import choose_port
from phyagentos.clock import SystemClock
from phyagentos.fleet.bus import HUB, Bucket, BusLost, HostCard, encode_key
from phyagentos.fleet.host import BY, FleetHost
from phyagentos.fleet.lanes import LanePublisher, LaneReplica
from phyagentos.fleet.server_settings import ALL
from phyagentos.operations.fleet import open_bus, prepare_server, read_status, stop_fleet
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.estop import is_latched
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.journal import Entry, Journal
from phyagentos.testing import make_contract
from tests.certificates import make_certificate
from tests.following import wait_until

nats = pytest.importorskip("nats", reason="needs the extra `fleet`: make test-extras")
pytestmark = pytest.mark.extras
CLOCK = SystemClock()


class Server:
    """A server that can be killed and started again; by settings a member of them."""

    def __init__(self, store, **options):
        self.port = choose_port()
        self.prepared = prepare_server(store, f"127.0.0.1:{self.port}", **options)
        self.url = self.prepared.urls.get(ALL, "")
        self._store = store
        self.start()

    def start(self):
        with (self._store / "log").open("ab") as log:
            self._process = subprocess.Popen(self.prepared.command, stderr=log, stdout=log)

    def kill(self):
        self._process.kill()
        self._process.wait()


@pytest.fixture
def server(tmp_path):
    server = Server(tmp_path / "server")
    yield server
    server.kill()


@pytest.fixture
def bus(server):
    with open_bus(server.url, "test") as bus:
        bus.wait(20.0)
        yield bus


@pytest.fixture
def journal(tmp_path):
    with closing(Journal(tmp_path / "w", side=Side.AGENT, by="a", clock=CLOCK, partition="h.1")) as journal:
        yield journal


def fill(journal, *names):
    for name in names:
        contract = make_contract(id=f"g.{name}")
        journal.commit([Entry(contract.id, "submit", dict(msgspec.to_builtins(contract)))])
    return journal.read_new()[-1].seq


def test_a_claim_is_taken_once_and_a_stale_revision_is_refused(bus):
    first = bus.swap(Bucket.CLAIMS, "a", b"open", 0)
    assert bus.swap(Bucket.CLAIMS, "a", b"open", 0) is None
    second = bus.swap(Bucket.CLAIMS, "a", b"h1", first)
    assert bus.swap(Bucket.CLAIMS, "a", b"h2", first) is None
    assert bus.get(Bucket.CLAIMS, "a") == (b"h1", second, HUB)
    wait_until(lambda: bus.view(Bucket.CLAIMS) == {"a": (b"h1", second, HUB)})
    bus.put_all({(Bucket.CLAIMS, "a"): None})
    assert bus.swap(Bucket.CLAIMS, "a", b"h2", second) is None
    assert bus.get(Bucket.CLAIMS, "a") is None


def test_a_lane_arrives_once_over_a_server_that_is_killed(bus, server, journal, tmp_path, read_with_node):
    publisher = LanePublisher(journal, bus)
    assert not publisher.publish(fill(journal, *"abc"))
    server.kill()
    last = fill(journal, *"def")
    wait_until(lambda: not bus.is_connected)
    with pytest.raises(BusLost):
        publisher.publish(last)
    server.start()
    wait_until(lambda: bus.is_connected)
    publisher.publish(last)
    sent_before = bus.read("h.1", 2, last)
    with pytest.raises(BusLost, match="wrong last sequence"):
        bus.append("h.1", 2, sent_before)
    wait_until(lambda: bus.find_end("h.1") == last)

    replica = LaneReplica(tmp_path / "copy", "h.1")
    replica.take(bus.read("h.1", 0, bus.count("h.1")))
    replica.close()

    own, copy = read_with_node(tmp_path / "w", tmp_path / "copy")
    assert own["sha256"] == copy["sha256"]
    assert copy["records"] == bus.count("h.1") == last


def test_a_link_that_is_cut_is_noticed_and_mended(server):
    link = Link(server.port)
    with open_bus(server.url.replace(f":{server.port}", f":{link.port}"), "test") as bus:
        bus.wait(20.0)
        link.is_cut = True
        with pytest.raises(BusLost):
            bus.put(Bucket.HOSTS, "a", b"1")
        link.mend()
        wait_until(lambda: bus.is_connected)
        bus.put(Bucket.HOSTS, "a", b"2")
        assert bus.get(Bucket.HOSTS, "a").value == b"2"


def test_an_object_is_kept_by_its_name(bus):
    data = os.urandom(300_000)
    bus.count("hub")  # which makes its store
    assert bus.load("hub", "b") is None
    bus.store("b", data)
    bus.store("b", data)
    assert bus.load("hub", "b") == data
    bus.store("empty", b"")
    assert bus.load("hub", "empty") == b""
    bus._call(lambda: bus._js.purge_stream("OBJ_paos_evidence_hub", subject="$O.*.C.>"))
    assert bus.load("hub", "b") == b""  # damaged: it is not waited for


@pytest.mark.parametrize("number", range(4))
def test_an_object_is_whole_whichever_answer_is_lost(bus, monkeypatch, number):
    data, numbers = os.urandom(300_000), itertools.count()  # three chunks, then its list
    bus.count("hub")

    async def publish(self, *arguments, **options):
        answer = await publish_before(self, *arguments, **options)
        if next(numbers) == number:
            raise nats.errors.TimeoutError
        return answer

    publish_before = nats.js.JetStreamContext.publish
    monkeypatch.setattr(nats.js.JetStreamContext, "publish", publish)
    with pytest.raises(BusLost):
        bus.store("b", data)
    bus.store("b", data)
    assert bus.load("hub", "b") == data
    assert next(numbers) == 4  # nothing was sent twice


def test_the_stop_of_a_fleet_latches_on_a_host(server, bus, journal, tmp_path):
    workspace = Workspace.create(tmp_path / "host", Library(()))
    with closing(Journal(workspace.root, side=Side.AGENT, by=BY, clock=CLOCK, partition="h1")) as own:
        host = FleetHost(workspace, own, bus, CLOCK, {"panda": ("pick_and_place",)})
        host.turn()
        begun_s = CLOCK.now_s()
        bus.put(Bucket.STOPS, "stop", b'{"by": "me", "at": "2026-11-30T00:00:00Z"}')
        wait_until(lambda: is_latched(workspace.signals.parent))
        assert CLOCK.now_s() - begun_s < 2.0  # some milliseconds where nothing else runs
        host.turn()
        (line,) = read_status(server.url).hosts
        assert (line.card.host, line.card.is_stopped, line.is_alive) == ("h1", True, False)
        assert stop_fleet(server.url, reason="again").stopped == ("h1",)


@pytest.mark.slow
def test_sessions_go_to_a_host_and_come_back_with_their_evidence(tmp_path):
    timed = time_fleet(tmp_path, 6, ["t0", "t1"])
    assert all(map(math.isfinite, sum_up(timed.records, 6)))
    assert timed.session.messages > 10
    bundles = list((tmp_path / "hub" / "evidence").glob("noop.*/execution.json"))
    assert len(bundles) == 6
    assert timed.stop_ms < 2000.0  # some milliseconds where nothing else runs


def test_a_claim_that_was_refused_is_not_what_the_hub_sees(server, bus):
    with open_bus(server.url, "host", "h1", ()) as host:
        host.wait(20.0)
        assert bus.swap(Bucket.CLAIMS, "a", b"first", 0)
        for _ in range(3):
            assert host.swap(Bucket.CLAIMS, "a", b"second", 0) is None
        CLOCK.sleep(1.0)
        assert bus.view(Bucket.CLAIMS)["a"].value == b"first"


SETTINGS = """
servers: {{a: {{listen: 127.0.0.1:{0}, cluster: 127.0.0.1:{1}}}, b: {{listen: 127.0.0.1:{2}, cluster: 127.0.0.1:{3}}},
  c: {{listen: 127.0.0.1:{4}, cluster: 127.0.0.1:{5}}}}}
hosts: [h.1, h2]
tls: {{certificate: this.pem, key: this.key, ca: this.pem}}
"""


@pytest.fixture
def cluster(tmp_path, monkeypatch):
    """Three servers by name, over TLS, with users."""
    _, certificate = make_certificate(tmp_path)
    monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
    settings = tmp_path / "fleet.yaml"
    settings.write_text(SETTINGS.format(*(choose_port() for _ in range(6))))
    servers = {name: Server(tmp_path / name, settings=settings, member=name) for name in "abc"}
    yield servers
    for server in servers.values():
        server.kill()


def test_a_host_can_write_what_is_its_own_alone_and_a_leader_that_is_killed_loses_nothing(
    cluster, journal, tmp_path, monkeypatch
):
    urls = cluster["a"].prepared.urls
    with contextlib.ExitStack() as stack:
        hub = stack.enter_context(open_bus(urls["hub"], "hub"))
        host, other = (stack.enter_context(open_bus(urls[name], name, name, ("t",))) for name in ("h.1", "h2"))
        for bus in (hub, host, other):
            bus.wait(60.0)
        lane = journal.folder.name
        hub.count(lane)
        revision = hub.swap(Bucket.CLAIMS, "s", b"open", 0)
        check_rights(host, hub)
        with monkeypatch.context() as context:
            context.setattr(nats.aio.client.Client, "publish", publish_twice)
            held = host.swap(Bucket.CLAIMS, "s", b"h2", revision)
        assert held is not None
        for key in map(str, range(20)):  # the answer to an earlier attempt does not come; what stands is known then
            opened = hub.swap(Bucket.CLAIMS, key, b"open", 0)
            asyncio.run_coroutine_threadsafe(host._swap(Bucket.CLAIMS, key, b"mine", opened), host._loop)
            assert host.swap(Bucket.CLAIMS, key, b"mine", opened) is None
            assert host.get(Bucket.CLAIMS, key).by == lane
        assert other.swap(Bucket.CLAIMS, "s", b"h2", revision) is None
        card = HostCard(host=lane, targets={"t": ()}, is_stopped=True)
        host.put(Bucket.HOSTS, encode_key(lane), msgspec.json.encode(card))
        assert read_status(urls["operator"]).hosts[0].card == card
        assert stop_fleet(urls["operator"]).stopped == (lane,)
        wait_until(lambda: host.view(Bucket.STOPS) and hub.view(Bucket.STOPS))
        host.store("b", b"data")
        publisher = LanePublisher(journal, host)
        publisher.publish(fill(journal, *"abc"))
        leader = json.loads(ask(hub, f"$JS.API.STREAM.INFO.paos_lane_{encode_key(lane)}").data)["cluster"]["leader"]
        cluster[leader].kill()
        last = fill(journal, *"def")
        assert not retry(publisher.publish, last)
        assert retry(hub.get, Bucket.CLAIMS, "s") == (b"h2", held, lane)
        wait_until(lambda: hub.view(Bucket.CLAIMS)["s"] == (b"h2", held, lane))  # who wrote it, not what it says
        replica = LaneReplica(tmp_path / "copy", lane)
        replica.take(retry(hub.read, lane, 0, last))
        replica.close()
        assert replica.seq == last
        assert retry(other.swap, Bucket.CLAIMS, "s", b"h2", revision) is None
        assert retry(hub.load, lane, "b") == b"data"


async def publish_twice(*arguments, publish=nats.aio.client.Client.publish, **options):
    await publish(*arguments, **options)
    await publish(*arguments, **options)


def retry(call, *arguments):
    """Until the servers have a leader again."""
    for _ in range(100):
        with contextlib.suppress(BusLost):
            return call(*arguments)
        CLOCK.sleep(0.2)
    return call(*arguments)


def ask(bus, subject, data=b""):
    return bus._call(lambda: bus._client.request(subject, data, timeout=0.5))


def check_rights(host, hub):
    """What is another's is refused: nothing changes, whoever sends it."""
    subjects = ["paos.lane.h2", "$KV.paos_hosts.h2", "$KV.paos_claims.s.h2", "$KV.paos_claims.s.hub"]
    subjects += ["$KV.paos_offers.t.s", "$KV.paos_stops.stop", "$O.paos_evidence_h2.M.x", "$JS.API.STREAM.LIST"]
    subjects += [f"$JS.API.STREAM.{verb}.KV_paos_claims" for verb in ("DELETE", "PURGE", "UPDATE", "MSG.DELETE")]
    subjects += ["$JS.API.STREAM.CREATE.paos_lane_h=2e=1", "$JS.API.CONSUMER.CREATE.KV_paos_hosts"]
    subjects += ["$JS.API.STREAM.PURGE.OBJ_paos_evidence_h=2e=1"]
    for subject in subjects:
        with pytest.raises(BusLost, match="Timeout"):
            ask(host, subject, b"{}")
    assert hub.get(Bucket.CLAIMS, "s").value == b"open"
    assert hub.get(Bucket.HOSTS, "h2") is None
    assert hub.get(Bucket.STOPS, "stop") is None
