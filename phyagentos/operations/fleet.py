"""A fleet: its server, the hub beside the agent, hosts that join, what is there, and the stop for all of it."""

import contextlib
import os
import re
import select
import shutil
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING

import msgspec

from phyagentos.agent.goals.selector import find_lacks
from phyagentos.assembly.paths import open_project, serve_alone
from phyagentos.assembly.planes import STOP_S, start_watch
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError, ExecutionError, needs_extra
from phyagentos.fleet.bus import (
    HOST_NAME,
    HUB,
    OPERATOR,
    PAGE,
    Bucket,
    Bus,
    Claim,
    HostCard,
    Offer,
    encode_key,
    hide_token,
    iter_read,
    read_cards,
    read_claim,
)
from phyagentos.fleet.host import BEAT_S, BY, FleetHost
from phyagentos.fleet.hub import LEASE_S, SILENCE_S, FleetHub
from phyagentos.fleet.server_settings import FleetSettings, configure, configure_alone
from phyagentos.protocol.capabilities.registries import read_skill_registry, read_target_registry
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime
from phyagentos.protocol.capabilities.targets import TargetProfile, find_own_world
from phyagentos.protocol.documents.schema import read_yaml, validate
from phyagentos.protocol.sessions.estop import Latch
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.workspace.process_lock import WATCHDOG_LOCK, become_sole
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.edits.edit_intake import EditIntake
from phyagentos.store.journal import Journal, choose_partition
from phyagentos.store.renderer import Views
from phyagentos.store.watch import Watch

if TYPE_CHECKING:
    from phyagentos.fleet.nats_bus import NatsBus

LISTEN = "127.0.0.1:4222"
PAUSE_MS = 200.0
ANSWER_S = 3.0


class HostLine(msgspec.Struct, frozen=True, kw_only=True):
    """One host as the server knows it, with the number of its records there; it is alive while it beats."""

    card: HostCard
    records: int
    is_alive: bool


class FleetServer(msgspec.Struct, frozen=True):
    """What `paos fleet server` prints: for hub, operator and each host its URL, and the command that runs it."""

    urls: Mapping[str, str]
    command: tuple[str, ...]


class FleetStatus(msgspec.Struct, frozen=True, kw_only=True):
    """What `paos fleet status` prints; `offers` are sessions that wait for a host, run, or wait for their verdict."""

    server: str
    hosts: tuple[HostLine, ...]
    offers: int


class FleetStop(msgspec.Struct, frozen=True, kw_only=True):
    """Which hosts have latched the stop, and which have not answered: these latch it when they are back."""

    stopped: tuple[str, ...]
    silent: tuple[str, ...]


class HostSeen(msgspec.Struct, frozen=True, kw_only=True):
    """A host, and how long ago its latest heartbeat came, or since when this side has listened [s]."""

    card: HostCard
    age_s: float

    @property
    def is_alive(self) -> bool:
        """Whether the hub counts on it."""
        return self.age_s < SILENCE_S


class Open(msgspec.Struct, frozen=True, kw_only=True):
    """A session that waits for a host, or has one."""

    offer: Offer
    claim: Claim

    @property
    def state(self) -> str:
        """How far it is in the fleet."""
        if self.claim.is_fenced or self.offer.is_cancelled:
            return "cancelling" if self.offer.is_cancelled else "outcome_unknown"
        return ("verifying" if self.offer.end else "running") if self.claim.host else "pending"


class FleetSeen(msgspec.Struct, frozen=True, kw_only=True):
    """What a page shows of a fleet; `stop` is the latest one for all."""

    server: str
    is_connected: bool
    hosts: tuple[HostSeen, ...]
    sessions: tuple[Open, ...]
    stop: Latch | None


class FleetWatch:
    """What is there in a fleet, as news of it come."""

    def __init__(self, bus: "NatsBus", url: str) -> None:
        self.bus, self._server, self._clock = bus, hide_token(url), SystemClock()
        self._beats: dict[str, tuple[int, float]] = {}  # revision of each card, and since when it is known [s]
        bus.on_change(Bucket.HOSTS, lambda _: self._note())

    def _note(self) -> None:
        for key, found in self.bus.view(Bucket.HOSTS).items():
            if self._beats.get(key, (0, 0.0))[0] != found.revision:
                self._beats[key] = found.revision, self._clock.now_s()

    def read(self) -> FleetSeen:
        """As of now."""
        self._note()
        now_s, claims = self._clock.now_s(), self.bus.view(Bucket.CLAIMS)
        hosts = (
            HostSeen(card=each, age_s=now_s - self._beats[encode_key(each.host)][1])
            for each in read_cards(self.bus.view(Bucket.HOSTS))
        )
        sessions = (
            Open(offer=each, claim=read_claim(claims.get(encode_key(each.contract.id))) or Claim())
            for each in iter_read(self.bus.view(Bucket.OFFERS).values(), Offer)
        )
        return FleetSeen(
            server=self._server,
            is_connected=self.bus.is_connected,
            hosts=tuple(hosts),
            sessions=tuple(sorted(sessions, key=lambda each: each.offer.number)),
            stop=next(iter_read(self.bus.view(Bucket.STOPS).values(), Latch), None),
        )


@contextlib.contextmanager
def watch_fleet(url: str) -> Iterator[FleetWatch]:
    """What is there in a fleet, while the block runs; also before its server answers."""
    with open_bus(url, "page", OPERATOR) as bus:
        yield FleetWatch(bus, url)


def prepare_server(store: Path, listen: str = LISTEN, *, settings: Path | None = None, member: str = "") -> FleetServer:
    """The URLs of a server of this fleet, and the command that runs it.

    It demands a token, or where there are `settings` a password of each user; they are made at the first start and
    kept. Raises DefinitionError `EXTRA_MISSING`, and of the settings.
    """
    binary = shutil.which("nats-server", path=os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"])))
    if binary is None:
        with needs_extra("fleet", "paos fleet server"):
            raise ImportError("no nats-server")
    store.mkdir(parents=True, exist_ok=True)
    if settings is None:
        access = configure_alone(store, listen)
    else:
        access = configure(validate(FleetSettings, read_yaml(settings)), settings.resolve(), member, store)
    config = store / "nats.conf"
    config.touch(mode=0o600)
    config.write_bytes(msgspec.json.format(msgspec.json.encode(access.config)))
    return FleetServer(access.urls, (binary, "-c", str(config)))


def lead_fleet(root: Path, url: str, ends: Event, announce: Callable[[str], object], lease_s: float = LEASE_S) -> None:
    """Place the sessions of this workspace on the hosts of a fleet, until `ends`.

    Raises ExecutionError `BUSY` where a watchdog or another hub serves it.
    """
    workspace, clock = open_project(root), SystemClock()
    busy = "a watchdog or another hub serves this workspace"
    lock = become_sole(workspace.root / WATCHDOG_LOCK, clock, "BUSY", busy, patience_s=STOP_S)
    with contextlib.ExitStack() as stack:
        stack.callback(os.close, lock)
        journal = stack.enter_context(contextlib.closing(Journal(root, side=Side.RUNTIME, by=BY, clock=clock)))
        bus = stack.enter_context(open_bus(url, f"hub {journal.folder.name}"))
        hub = stack.enter_context(contextlib.closing(FleetHub(workspace, journal, bus, clock, lease_s=lease_s)))
        edits = stack.enter_context(contextlib.closing(EditIntake(workspace, clock)))
        views = stack.enter_context(contextlib.closing(Views(workspace, journal.folder, clock, edits)))
        announce(f"hub of {workspace.root} at {hide_token(url)}")
        take_turns(lambda: hub.turn() | views.refresh(), bus, journal.folder, ends)


def join_fleet(
    root: Path,
    url: str,
    ends: Event,
    announce: Callable[[str], object],
    *,
    name: str | None = None,
    targets: Collection[str] = (),
    pictures: bool = True,
    page: str = "",
) -> None:
    """Carry out sessions of a fleet on targets of this workspace, all or those named, until `ends`.

    `page` is where people find the page of this workspace. Raises DefinitionError `UNKNOWN_NAME`, `INVALID_VALUE`;
    ExecutionError `BUSY`, `CHANGED`, `NOT_RUNNING`.
    """
    workspace, clock = open_project(root), SystemClock()
    if not re.match(PAGE, page):
        raise DefinitionError.of("INVALID_VALUE", "--page", page, "an address that begins with http:// or https://")
    known = read_target_registry(workspace.target_registry)
    if missing := sorted(set(targets) - known.keys()):
        raise DefinitionError.unknown("target", "--target", missing[0], known)
    _refuse_half_a_world(known, {*targets} or {*known})
    skills = read_skill_registry(workspace.skill_registry)
    served = {each: _list_skills(skills, known[each]) for each in targets or known}
    with contextlib.ExitStack() as stack:
        stack.enter_context(serve_alone(workspace, clock))
        lane = _choose_lane(workspace, name)
        journal = Journal(workspace.root, side=Side.AGENT, by=BY, clock=clock, partition=lane)
        stack.enter_context(contextlib.closing(journal))
        bus = stack.enter_context(open_bus(url, f"host {lane}", lane, served))
        host = FleetHost(workspace, journal, bus, clock, served, page)
        watch = stack.enter_context(start_watch(workspace, pictures=pictures).running(clock))
        announce(f"host {lane} at {hide_token(url)}: {', '.join(sorted(served))}")

        def turn() -> bool:
            if not watch.is_alive():
                last = " ".join(watch.read_printed()[-1:])
                raise ExecutionError("NOT_RUNNING", f"the watchdog of {workspace.root} ended: {last} Log: {watch.log}")
            return host.turn()

        take_turns(turn, bus, journal.folder, ends)


def _refuse_half_a_world(known: Mapping[str, TargetProfile], served: Collection[str]) -> None:
    """Two hosts have two worlds, in which different events happen: one world is on one host, or served to several."""
    worlds = {find_own_world(known[each]) for each in served} - {""}
    if missing := sorted(name for name, each in known.items() if each.world in worlds and name not in served):
        text = f"{', '.join(sorted(served))} without {missing[0]}"
        raise DefinitionError.of(
            "WORLD_CONFLICT", "--target", text, f"every target of the world {known[missing[0]].world!r}"
        )


def _list_skills(skills: Mapping[str, SkillRuntime], target: TargetProfile) -> tuple[str, ...]:
    return tuple(sorted(name for name, skill in skills.items() if not any(find_lacks(skill, target))))


def _choose_lane(workspace: Workspace, name: str | None) -> str:
    found = choose_partition(workspace.sessions)
    if not re.match(HOST_NAME, name or found) or name in {HUB, OPERATOR}:
        expected = f"at most 60 letters, no `/`, and none of {HUB}, {OPERATOR}"
        raise DefinitionError.of("INVALID_VALUE", "--name", name or found, expected)
    if name is None or name == found or not (workspace.sessions / found).is_dir():
        return name or found
    raise DefinitionError.of("INVALID_VALUE", "--name", name, f"{found!r}, as this workspace has been called so far")


@contextlib.contextmanager
def open_bus(url: str, name: str, role: str = HUB, targets: Collection[str] | None = None) -> Iterator["NatsBus"]:
    """A connection to a fleet while the block runs; raises DefinitionError `EXTRA_MISSING`."""
    with needs_extra("fleet", "paos fleet"):
        from phyagentos.fleet.nats_bus import NatsBus
    bus = NatsBus(url, name=name, role=role, targets=targets)
    try:
        yield bus
    finally:
        bus.close()


def take_turns(turn: Callable[[], bool], bus: Bus, folder: Path, ends: Event) -> None:
    """Take turns: at once after news or where more waits, else a few times a second."""
    with Watch([folder]) as records:
        poll = select.poll()
        for each in (records.fileno(), bus.fileno()):
            poll.register(each, select.POLLIN)
        while not ends.is_set():
            bus.drain()
            records.drain()
            if not turn():
                poll.poll(PAUSE_MS)


def read_status(url: str) -> FleetStatus:
    """Hosts and open sessions of a fleet; a host is alive that beats while this looks."""
    with open_bus(url, "status", OPERATOR) as bus:
        bus.wait(ANSWER_S)
        before = read_cards(bus.view(Bucket.HOSTS))
        SystemClock().sleep(2.0 * BEAT_S)
        lines = [
            HostLine(card=each, records=bus.count(each.host), is_alive=each not in before)
            for each in read_cards(bus.view(Bucket.HOSTS))
        ]
        return FleetStatus(server=hide_token(url), hosts=tuple(lines), offers=len(bus.view(Bucket.OFFERS)))


def stop_fleet(url: str, *, reason: str = "", by: str = "paos fleet stop") -> FleetStop:
    """Latch the emergency stop on every host; each resets its own with `paos estop --reset`."""
    with open_bus(url, by, OPERATOR) as bus:
        bus.wait(ANSWER_S)
        return stop_all(bus, reason=reason, by=by)


def stop_all(bus: Bus, *, reason: str, by: str) -> FleetStop:
    """The same over a connection that is there."""
    clock = SystemClock()
    bus.put(Bucket.STOPS, "stop", msgspec.json.encode(Latch(by=by, reason=reason, at=clock.wall_iso())))
    deadline_s = clock.now_s() + ANSWER_S
    while not all(each.is_stopped for each in read_cards(bus.view(Bucket.HOSTS))) and clock.now_s() < deadline_s:
        clock.sleep(0.02)
    cards = read_cards(bus.view(Bucket.HOSTS))
    stopped, silent = (tuple(each.host for each in cards if each.is_stopped is is_it) for is_it in (True, False))
    return FleetStop(stopped=stopped, silent=silent)
