"""Sessions on hosts that share nothing but the server: each is begun once, and a host that is cut off stops in time."""

from concurrent.futures import wait
from contextlib import closing
from types import SimpleNamespace

import msgspec
import pytest

from phyagentos.assembly.processes import locate_doors
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.fleet.bus import Bucket, BusLost, Claim, HostCard, Offer, encode_key, read_cards
from phyagentos.fleet.host import BY, FleetHost
from phyagentos.fleet.hub import GRACE_S, LEASE_S, FleetHub
from phyagentos.operations.fleet import _choose_lane, _refuse_half_a_world
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.estop import is_latched, reset
from phyagentos.protocol.sessions.lease_files import ENDED_S, read_lease, write_lease
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Ended, Execution, Limits
from phyagentos.protocol.sessions.verdicts import Attempt, Verdict
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.follower import Follower
from phyagentos.store.journal import Entry, Journal
from phyagentos.store.ledger import Ledger
from phyagentos.testing import ManualClock, make_contract

from .fake_bus import FakeBus, FakeServer

DONE = Execution(ended=Ended.COMPLETED, evidence="evidence/g.a")
VERDICT = Attempt(verdict=Verdict.SUCCESS, criteria=())


class Place:
    """One workspace with its journals; a host, or the hub."""

    def __init__(self, root, server, clock, *, name, is_hub=False, targets=("panda",)):
        self.workspace, self.clock, self.bus = Workspace.create(root, Library(())), clock, FakeBus(server, name)
        self.agent = Journal(root, side=Side.AGENT, by=BY if not is_hub else "agent", clock=clock, partition=name)
        self.runtime = Journal(root, side=Side.RUNTIME, by="watchdog", clock=clock, partition=name)
        self.targets = dict.fromkeys(targets, ("pick_and_place",))
        self.open(is_hub=is_hub)

    def open(self, *, is_hub=False):
        """Begin, also again: a process of this place after the one that was killed."""
        if is_hub:
            self.process = FleetHub(self.workspace, self.runtime, self.bus, self.clock)
        else:
            self.process = FleetHost(self.workspace, self.agent, self.bus, self.clock, self.targets)

    def reopen(self):
        self.agent.close()
        self.agent = Journal(
            self.workspace.root, side=Side.AGENT, by=BY, clock=self.clock, partition=self.agent.folder.name
        )
        self.open()

    def run(self, id, *entries):
        """What a watchdog would record."""
        self.runtime.commit([Entry(id, *each) for each in entries])

    def begin(self, id):
        self.run(id, ("claim",), ("check", None, 1), ("start", None, 1))

    def finish(self, id):
        folder = self.workspace.evidence_of(id)
        (folder / "shown").mkdir(parents=True)
        (folder / "execution.json").write_text("{}")
        (folder / "shown" / "a.md").write_text("b")
        self.run(id, ("halt", None, 1), ("finish", {"execution": msgspec.to_builtins(DONE)}, 1))

    def read_state(self, id="g.a"):
        ledger, follower = Ledger(forgets=False), Follower(self.agent.folder)
        ledger.extend(follower.read_new())
        follower.close()
        return ledger.sessions[id].state if id in ledger.sessions else None

    def close(self):
        for each in (self.agent, self.runtime, *([self.process] if isinstance(self.process, FleetHub) else [])):
            each.close()


class Fleet:
    """A hub and two hosts with a target of one name."""

    def __init__(self, root):
        self.server, self.clock = FakeServer(), ManualClock(1e6)
        self.hub = Place(root / "hub", self.server, self.clock, name="hub", is_hub=True)
        self.hosts = [Place(root / name, self.server, self.clock, name=name) for name in ("h1", "h2")]

    def submit(self, id="g.a", **facts):
        contract = make_contract(id=id, **facts)
        self.hub.agent.commit([Entry(id, "submit", dict(msgspec.to_builtins(contract)))])

    def turn(self, *places, seconds=0.0):
        """Some turns of these, all by default; time goes by between them."""
        for _ in range(4):
            for place in places or (self.hub, *self.hosts):
                place.process.turn()
                transfers = place.process._fetched if place is self.hub else place.process._transfers
                wait(transfers.running.values())
            self.clock.advance(seconds / 4)

    def find_holder(self, id="g.a"):
        (holder,) = (host for host in self.hosts if host.read_state(id) is not None)
        return holder

    def place(self):
        """A session that runs on one of them; which, and the other."""
        self.turn(seconds=2.0)
        self.submit()
        self.turn()
        holder = self.find_holder()
        holder.begin("g.a")
        self.turn()
        return holder, next(host for host in self.hosts if host is not holder)


@pytest.fixture
def fleet(tmp_path):
    fleet = Fleet(tmp_path)
    yield fleet
    for place in (fleet.hub, *fleet.hosts):
        place.close()


def test_a_session_runs_on_one_host_and_its_verdict_comes_back_there(fleet):
    holder, _ = fleet.place()
    assert fleet.hub.read_state() == "running"
    holder.finish("g.a")
    fleet.turn()
    assert fleet.hub.read_state() == "awaiting_verification"
    assert (fleet.hub.workspace.evidence_of("g.a") / "shown" / "a.md").read_text() == "b"

    body = {"attempt": msgspec.to_builtins(VERDICT)}
    fleet.hub.agent.commit([Entry("g.a", "verify"), Entry("g.a", "accept", body)])
    fleet.turn()

    assert holder.read_state() == fleet.hub.read_state() == "succeeded"
    assert not fleet.server.values[Bucket.OFFERS]
    assert not fleet.server.values[Bucket.CLAIMS]
    lane = holder.agent.folder.name
    copy = fleet.hub.process.get_replica_root(lane) / "sessions" / lane
    (segment,) = copy.glob("*.md")
    assert segment.read_bytes() == (holder.agent.folder / segment.name).read_bytes()


def test_a_host_that_is_cut_off_stops_within_its_lease_and_does_not_go_on_when_it_is_back(fleet):
    holder, _ = fleet.place()
    holder.bus.is_connected, cut_s = False, fleet.clock.now_s()
    fleet.turn(seconds=2.0 * (LEASE_S + GRACE_S))  # the hub counts from when it looks
    fleet.turn()

    assert read_lease(holder.workspace.leases, "g.a") <= cut_s + LEASE_S
    assert fleet.hub.read_state() == "awaiting_verification"  # lost with its target; the agent decides
    claim = msgspec.json.decode(fleet.server.values[Bucket.CLAIMS]["g=2e=a"].value, type=Claim)
    assert (claim.is_fenced, claim.epoch) == (True, 2)

    holder.bus.is_connected = True
    fleet.turn(seconds=4.0)
    assert read_lease(holder.workspace.leases, "g.a") == ENDED_S
    assert holder.read_state() == "cancelling"
    holder.run("g.a", ("confirm_cancel", None, 1))
    fleet.turn()
    assert fleet.hub.read_state() == "awaiting_verification"  # what came after the fence changes nothing here


def test_a_host_that_alone_has_the_target_finishes_while_it_is_cut_off(fleet):
    _, other = fleet.hosts
    other.bus.is_connected = False  # never joined
    fleet.turn(fleet.hub, fleet.hosts[0], seconds=2.0)
    fleet.submit(limits=Limits(timeout_s=60.0))
    fleet.turn(fleet.hub, holder := fleet.hosts[0])
    holder.begin("g.a")
    holder.bus.is_connected = False
    fleet.turn(seconds=LEASE_S + GRACE_S + 30.0)
    assert read_lease(holder.workspace.leases, "g.a") > fleet.clock.now_s()
    assert fleet.hub.read_state() == "pending"
    holder.finish("g.a")

    holder.bus.is_connected = True
    fleet.turn()

    assert fleet.hub.read_state() == "awaiting_verification"


def test_of_two_hosts_that_claim_at_once_one_begins(fleet):
    fleet.turn(seconds=2.0)
    fleet.submit()
    fleet.turn(fleet.hub)
    (offer,) = (msgspec.json.decode(each.value, type=Offer) for each in fleet.hub.bus.view(Bucket.OFFERS).values())
    for host in fleet.hosts:
        host.process._take(offer)

    assert [host.read_state() for host in fleet.hosts] == ["pending", None]


def test_a_claim_whose_answer_was_lost_is_taken_up_by_its_own_host(fleet):
    first, second = fleet.hosts
    fleet.turn(seconds=2.0)
    fleet.submit()
    fleet.turn(fleet.hub)
    first.bus.loses_answers = True
    first.process._beat_at_s = first.process._clock.now_s() + 60.0  # the first call whose answer is lost is the claim
    fleet.turn(first, second)
    assert [host.read_state() for host in fleet.hosts] == [None, None]
    first.bus.loses_answers = False
    first.reopen()

    fleet.turn()

    assert [host.read_state() for host in fleet.hosts] == ["pending", None]


@pytest.mark.parametrize("hears_of_the_claim", [False, True])
def test_an_offer_whose_answer_was_lost_counts_as_sent(fleet, hears_of_the_claim):
    fleet.turn(seconds=2.0)
    fleet.submit()
    fleet.server.loses_offers = True
    fleet.hub.process.turn()
    fleet.server.loses_offers = False
    holder, body = fleet.hosts[0], {"attempt": msgspec.to_builtins(VERDICT)}
    holder.process.turn()
    if hears_of_the_claim:
        holder.begin("g.a")
        holder.process.turn()
        fleet.turn()
    else:
        fleet.turn()
        holder.begin("g.a")
    holder.finish("g.a")
    fleet.turn()
    fleet.hub.agent.commit([Entry("g.a", "verify"), Entry("g.a", "accept", body)])
    fleet.turn()
    assert holder.read_state() == fleet.hub.read_state() == "succeeded"
    assert not fleet.server.values[Bucket.OFFERS]


def test_a_host_that_is_started_again_may_not_command_before_its_claim_is_confirmed(fleet):
    holder, _ = fleet.place()
    holder.bus.is_connected = False
    write_lease(holder.workspace.leases, "g.a", 1e9)  # of the machine before it was started anew
    holder.reopen()
    assert read_lease(holder.workspace.leases, "g.a") == ENDED_S
    holder.bus.is_connected = True

    fleet.turn(seconds=1.0)

    assert fleet.clock.now_s() < read_lease(holder.workspace.leases, "g.a") <= fleet.clock.now_s() + LEASE_S


def test_what_no_host_takes_is_refused_in_time_and_taken_by_none_later(fleet):
    fleet.submit(target="unknown", limits=Limits(queue_s=10.0))
    fleet.turn(seconds=12.0)
    fleet.turn(seconds=2.0)
    assert fleet.hub.read_state() == "rejected"
    assert not fleet.server.values[Bucket.OFFERS]


def test_a_cancelled_session_is_cancelled_on_its_host(fleet):
    holder, _ = fleet.place()
    fleet.hub.agent.commit([Entry("g.a", "request_cancel", {"reason": "no more"})])
    fleet.turn()
    assert holder.read_state() == "cancelling"
    holder.run("g.a", ("confirm_cancel", None, 1))

    fleet.turn()

    assert fleet.hub.read_state() == "cancelled"


def test_a_session_that_finished_while_its_end_was_requested_is_cancelled_on_both_sides(fleet):
    holder, _ = fleet.place()
    holder.finish("g.a")
    fleet.hub.agent.commit([Entry("g.a", "request_cancel", {"reason": "no more"})])

    fleet.turn()

    assert (fleet.hub.read_state(), holder.read_state()) == ("cancelled", "cancelled")


def test_evidence_of_a_cancelled_session_comes_after_a_transfer_that_broke_off(fleet, monkeypatch):
    holder, _ = fleet.place()
    holder.finish("g.a")
    fleet.hub.agent.commit([Entry("g.a", "request_cancel", {"reason": "no more"})])

    def store(*_):
        raise BusLost("cut")

    with monkeypatch.context() as context:
        context.setattr(holder.bus, "store", store)
        fleet.turn()
    assert (fleet.hub.read_state(), holder.read_state()) == ("cancelling", "cancelled")
    fleet.turn()
    assert fleet.hub.read_state() == "cancelled"
    assert (fleet.hub.workspace.evidence_of("g.a") / "execution.json").exists()
    fleet.turn()
    assert not holder.process._transfers._done


def test_a_resource_is_given_to_one_session_at_a_time_on_whatever_host(fleet):
    fleet.turn(seconds=2.0)
    fleet.submit("g.a", resources=("tray",))
    fleet.submit("g.b", resources=("tray",))
    fleet.turn()
    assert [fleet.hub.read_state(each) for each in ("g.a", "g.b")] == ["pending", "pending"]
    assert len(fleet.server.values[Bucket.OFFERS]) == 1
    holder = fleet.find_holder()
    holder.begin("g.a")
    holder.finish("g.a")

    fleet.turn()

    assert len(fleet.server.values[Bucket.OFFERS]) == 2


def test_the_stop_latches_on_every_host_also_on_one_that_comes_back_and_each_resets_its_own(fleet):
    here, away = fleet.hosts
    away.bus.is_connected = False
    stop = msgspec.json.encode({"by": "me", "reason": "smoke", "at": "2026-11-30T00:00:00Z"})
    fleet.hub.bus.put(Bucket.STOPS, "stop", stop)
    assert [is_latched(host.workspace.signals.parent) for host in fleet.hosts] == [True, False]

    away.bus.is_connected = True
    fleet.turn(seconds=2.0)
    assert is_latched(away.workspace.signals.parent)
    reset(here.workspace.signals.parent, "smoke is gone", here.clock)
    fleet.turn(seconds=2.0)
    assert not is_latched(here.workspace.signals.parent)


def test_a_second_host_of_one_name_is_refused(fleet, tmp_path):
    fleet.turn(seconds=2.0)
    twin = Place(tmp_path / "twin", fleet.server, fleet.clock, name="h1")

    def beat(seconds):
        card = msgspec.json.decode(fleet.server.values[Bucket.HOSTS][encode_key("h1")].value, type=HostCard)
        fleet.server.write(Bucket.HOSTS, "h1", msgspec.json.encode(msgspec.structs.replace(card, beat=card.beat + 1)))

    twin.clock = twin.process._clock = ManualClock(1e6)
    twin.clock.sleep = beat
    with closing(twin), pytest.raises(ExecutionError, match="another host of the name 'h1'"):
        twin.process.turn()


def test_a_workspace_keeps_its_name(tmp_path):
    workspace = Workspace.create(tmp_path / "w", Library(()))
    assert _choose_lane(workspace, "h1") == "h1"
    (workspace.sessions / "h1").mkdir()
    assert _choose_lane(workspace, None) == "h1"
    with pytest.raises(Exception, match="'h1', as this workspace has been called so far"):
        _choose_lane(workspace, "h2")


def test_what_leads_out_of_a_workspace_or_has_another_form_is_not_followed_and_ends_nothing(fleet, tmp_path):
    card = msgspec.to_builtins(HostCard(host="h3", targets={"panda": ()}))
    offer = msgspec.to_builtins(Offer(contract=make_contract(id="g.b"), number=1, revision=0, lease_s=9.0))
    offer["contract"]["id"] = "../../g.b"
    for bucket, values in {
        Bucket.HOSTS: [card | {"host": "../../h3"}, card | {"host": ".."}, card | {"host": "h\0003"}, {"other": 1}],
        Bucket.OFFERS: [offer, {"other": 1}],
    }.items():
        for number, value in enumerate(values):
            fleet.server.write(bucket, f"panda.x{number}", msgspec.json.encode(value))
    before = {*tmp_path.rglob("*3"), *tmp_path.rglob("g.b*")}
    holder, _ = fleet.place()
    assert {*tmp_path.rglob("*3"), *tmp_path.rglob("g.b*")} == before
    assert holder.read_state() is not None


@pytest.mark.parametrize("name", ["../h3", "..", "a/b", "hub", "h" * 99])
def test_a_host_is_called_by_the_name_of_a_folder(tmp_path, name):
    with pytest.raises(DefinitionError, match="INVALID_VALUE"):
        _choose_lane(Workspace.create(tmp_path / "w", Library(())), name)


def test_a_host_that_lost_a_claim_does_not_try_it_again(fleet, monkeypatch):
    _, other = fleet.place()
    tried = []
    swap = other.bus.swap
    monkeypatch.setattr(other.bus, "swap", lambda *call: tried.append(call) or swap(*call))
    fleet.turn(seconds=1.0)
    assert tried == []


def test_a_session_whose_host_is_lost_is_tried_again_on_the_other_one(fleet):
    holder, other = fleet.place()
    holder.bus.is_connected = False
    fleet.turn(seconds=2.0 * (LEASE_S + GRACE_S))
    fleet.turn()
    (status,) = fleet.hub.process._ledger.sessions.values()
    assert status.execution.code == "HOST_LOST"
    fleet.submit("g.a-2")
    fleet.turn()
    assert other.read_state("g.a-2") == "pending"


def test_what_no_other_host_can_carry_out_is_lost_with_its_target(fleet):
    holder, other = fleet.place()
    other.process._card = msgspec.structs.replace(other.process._card, targets={"panda": ("push",)})
    holder.bus.is_connected = False
    fleet.turn(seconds=2.0 * (LEASE_S + GRACE_S))
    fleet.turn()
    (status,) = fleet.hub.process._ledger.sessions.values()
    assert status.execution.code == "TARGET_LOST"


def test_a_session_goes_to_a_host_that_has_its_skill_and_of_those_to_the_one_that_does_less(fleet):
    first, second = fleet.hosts
    first.process._card = msgspec.structs.replace(first.process._card, targets={"panda": ("push",), "ur5e": ("push",)})
    second.process._card = msgspec.structs.replace(second.process._card, targets={"ur5e": ("push", "pick_and_place")})
    fleet.turn(seconds=2.0)
    fleet.submit("g.a", target="ur5e")
    fleet.turn()
    assert fleet.find_holder("g.a") is second
    second.process._card = msgspec.structs.replace(second.process._card, targets={"panda": ("push",)})
    fleet.turn(seconds=2.0)
    fleet.submit("g.b", target="panda", skill="push")
    fleet.turn(fleet.hub, second)
    assert second.read_state("g.b") is None  # it has a session, and leaves this one to the other
    fleet.turn(fleet.hub, first)
    assert fleet.find_holder("g.b") is first


def test_a_host_has_no_say_in_a_session_that_another_one_holds(fleet):
    _, other = fleet.place()
    contract = make_contract(id="g.a")
    other.agent.commit([Entry("g.a", "submit", dict(msgspec.to_builtins(contract)))])
    other.begin("g.a")
    other.finish("g.a")
    fleet.turn()
    assert fleet.hub.read_state() == "running"
    assert not fleet.hub.workspace.evidence_of("g.a").exists()


def test_evidence_is_where_the_hub_has_put_it_whatever_its_host_calls_it(fleet):
    holder, _ = fleet.place()
    (holder.workspace.evidence_of("g.a")).mkdir(parents=True)
    elsewhere = msgspec.to_builtins(msgspec.structs.replace(DONE, evidence="../../other"))
    holder.run("g.a", ("halt", None, 1), ("finish", {"execution": elsewhere}, 1))
    fleet.turn()
    (status,) = fleet.hub.process._ledger.sessions.values()
    assert (status.state, status.execution.evidence) == ("awaiting_verification", "evidence/g.a")


@pytest.mark.parametrize("listed", [b"no list", b'{"../x": "ab"}', b'{"a": "ab"}', b'{"": "ab"}'])
def test_evidence_that_is_damaged_or_leads_out_ends_its_session_and_no_hub(fleet, listed):
    holder, _ = fleet.place()
    holder.bus.store = lambda name, data: fleet.server.objects.setdefault(name, listed)
    holder.finish("g.a")
    fleet.turn()
    assert fleet.hub.read_state() == "awaiting_verification"


def test_a_lane_that_is_damaged_concerns_its_host_alone(fleet):
    holder, other = fleet.place()
    lane = fleet.server.lanes[holder.agent.folder.name]
    holder.run("g.a", ("halt", None, 1))
    lane.append(lane[-1]._replace(data=b"no record"))
    fleet.turn(fleet.hub, other, seconds=2.0)
    (status,) = fleet.hub.process._ledger.sessions.values()
    assert (status.state, status.execution.code) == ("awaiting_verification", "HOST_LOST")
    assert "damaged" in status.execution.message


def test_what_cannot_be_read_as_claim_or_stop_ends_nothing_and_stops_all(fleet):
    fleet.turn(seconds=2.0)
    fleet.submit(limits=Limits(queue_s=10.0))
    fleet.turn(fleet.hub)
    fleet.server.write(Bucket.CLAIMS, encode_key("g.a"), b"other")
    fleet.server.write(Bucket.STOPS, "stop", b"other")
    fleet.turn(seconds=20.0)
    fleet.turn(seconds=2.0)
    assert fleet.hub.read_state() == "rejected"
    assert all(is_latched(host.workspace.signals.parent) for host in fleet.hosts)


def test_what_runs_is_given_up_when_the_server_has_lost_its_claims(fleet):
    fleet.place()
    for bucket in Bucket:
        fleet.server.values[bucket].clear()
    fleet.hub.bus.is_connected = False
    fleet.turn(fleet.hub)
    fleet.hub.bus.is_connected = True
    fleet.turn()
    assert fleet.hub.read_state() == "awaiting_verification"


def test_a_claim_of_an_earlier_session_of_the_same_name_is_not_taken_over(fleet):
    fleet.turn(seconds=2.0)
    fleet.server.write(Bucket.CLAIMS, encode_key("g.a"), msgspec.json.encode(Claim(epoch=1)), "h3")
    fleet.submit()
    fleet.turn()
    assert fleet.hub.read_state() == "rejected"
    assert [host.read_state() for host in fleet.hosts] == [None, None]


def test_a_host_of_another_name_than_its_key_does_not_count(fleet):
    fleet.server.write(Bucket.HOSTS, "h9", msgspec.json.encode(HostCard(host="h1", targets={"panda": ()}, beat=7)))
    fleet.turn(fleet.hub)
    assert fleet.hub.process._cards == []
    assert read_cards(fleet.hub.bus.view(Bucket.HOSTS)) == []


def test_who_claims_is_whose_subject_it_is_whatever_host_the_claim_names(fleet):
    named, writer = fleet.hosts
    fleet.turn(seconds=2.0)
    fleet.submit()
    fleet.turn(fleet.hub)
    (opened,) = fleet.hub.bus.view(Bucket.CLAIMS).values()
    forged = msgspec.json.encode(Claim(host="h1", epoch=1, lease_s=LEASE_S, is_fenced=True))
    assert writer.bus.swap(Bucket.CLAIMS, encode_key("g.a"), forged, opened.revision)
    fleet.turn(named)
    assert named.read_state() is None
    assert not fleet.hub.process._holds("h1", "g.a")
    assert fleet.hub.process._holds("h2", "g.a")


def test_a_claim_that_another_host_takes_over_is_fenced_and_its_host_has_no_say(fleet):
    holder, other = fleet.place()
    (held,) = fleet.hub.bus.view(Bucket.CLAIMS).values()
    taken = msgspec.json.encode(Claim(epoch=1, lease_s=LEASE_S))
    assert other.bus.swap(Bucket.CLAIMS, encode_key("g.a"), taken, held.revision)
    contract = make_contract(id="g.a")
    other.agent.commit([Entry("g.a", "submit", dict(msgspec.to_builtins(contract)))])
    other.begin("g.a")
    other.finish("g.a")
    fleet.turn(other, fleet.hub, seconds=2.0)
    (status,) = fleet.hub.process._ledger.sessions.values()
    assert (status.state, status.execution.code) == ("awaiting_verification", "HOST_LOST")
    assert holder.agent.folder.name in status.execution.message
    assert not fleet.hub.workspace.evidence_of("g.a").exists()


def test_what_is_over_is_forgotten(fleet):
    holder, other = fleet.place()
    holder.finish("g.a")
    fleet.turn()
    fleet.hub.agent.commit([Entry("g.a", "verify"), Entry("g.a", "accept", {"attempt": msgspec.to_builtins(VERDICT)})])
    fleet.turn()
    hub, host = fleet.hub.process, holder.process
    left = [hub._over, hub._waiting, hub._placed, hub._fetched._done, other.process._lost, other.process._offers]
    assert not any([*left, host._held, host._transfers._done])


def test_an_episode_goes_on_in_the_world_of_its_host_while_that_one_is_alive(fleet):
    holder, other = fleet.place()
    holder.finish("g.a")
    fleet.turn()
    holder.process._card = msgspec.structs.replace(holder.process._card, load=5)
    fleet.submit("g.b")
    fleet.turn(fleet.hub, other)
    assert other.read_state("g.b") is None
    fleet.turn(fleet.hub, holder)
    assert fleet.find_holder("g.b") is holder
    holder.bus.is_connected = False
    fleet.turn(seconds=2.0 * (LEASE_S + GRACE_S))
    fleet.submit("g.c")
    fleet.turn()
    assert fleet.find_holder("g.c") is other


def test_a_target_that_is_unknown_here_keeps_no_other_one_from_being_shown(fleet, monkeypatch):
    shown = []
    monkeypatch.setattr("phyagentos.fleet.hub.publish_health", lambda path, health: shown.append(set(health)))
    hub = fleet.hub.process
    hub._world_of = {"panda": "panda"}
    first = fleet.hosts[0].process
    first._card = msgspec.structs.replace(first._card, targets={"panda": (), "of_another_project": ()})
    fleet.turn(seconds=2.0)
    assert shown == [{"panda"}]


def test_a_host_offers_a_shared_world_as_a_whole():
    worlds = {"l": "table", "r": "table", "p": ""}
    known = {name: SimpleNamespace(world=world, driver="mujoco") for name, world in worlds.items()}
    _refuse_half_a_world(known, {"p"})
    _refuse_half_a_world(known, {"l", "r"})
    with pytest.raises(DefinitionError, match="l without r"):
        _refuse_half_a_world(known, {"l"})
    _refuse_half_a_world(dict.fromkeys(worlds, SimpleNamespace(world="table", driver="remote")), {"l"})  # one, served


def test_targets_of_a_served_world_have_a_port_each():
    assert locate_doors("wss://[::1]:7000", "lr") == {"l": "wss://[::1]:7000", "r": "wss://[::1]:7001"}
    assert locate_doors("ws://127.0.0.1:0", "lr") == dict.fromkeys("lr", "ws://127.0.0.1:0")
    assert locate_doors("/run/a/table.world", "l") == {"l": "/run/a/l.world"}


def test_a_store_without_a_leader_keeps_no_lease_from_being_renewed(fleet):
    holder, _ = fleet.place()
    fleet.server.lost = {Bucket.HOSTS, Bucket.STOPS}
    fleet.turn(seconds=2.0 * (LEASE_S + GRACE_S))
    fleet.turn()
    assert read_lease(holder.workspace.leases, "g.a") > fleet.clock.now_s()
    assert fleet.hub.read_state() == "running"
    holder.finish("g.a")
    fleet.turn()
    assert fleet.hub.read_state() == "awaiting_verification"
