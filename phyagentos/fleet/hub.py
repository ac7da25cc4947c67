"""The hub of a fleet: it stands in the agent's workspace where a watchdog would, and places its sessions on hosts.

What a host records about a session is recorded here as well, once its evidence is here: the agent sees one journal.
A session is placed once. One whose host falls silent is fenced, then reported as lost; the agent decides
what follows.
"""

import contextlib
from collections import defaultdict, deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import msgspec

from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, ExecutionError, Problem
from phyagentos.fleet.bundles import Transfers, fetch_bundle
from phyagentos.fleet.bus import (
    Bucket,
    Bus,
    BusLost,
    Claim,
    EndEntry,
    HostCard,
    Offer,
    Stored,
    encode_key,
    get_offer_key,
    iter_read,
    read_cards,
    read_claim,
)
from phyagentos.fleet.host import BY
from phyagentos.fleet.lanes import LaneReplica
from phyagentos.protocol.capabilities.registries import publish_health, read_target_registry
from phyagentos.protocol.capabilities.targets import Health, TargetHealth
from phyagentos.protocol.sessions.estop import read_latch
from phyagentos.protocol.sessions.lifecycle import CLAIM, FINAL_STATES, Fenced, IllegalTransition, SessionState, Side
from phyagentos.protocol.sessions.session import Ended, Execution, Session, SessionId, SessionStatus
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.supervision.operator_signals import OperatorSignals
from phyagentos.runtime.supervision.supervisor_journal import SupervisorJournal, make_rejection
from phyagentos.store.journal import Entry, Journal, Record

LEASE_S = 15.0  # of a target that several hosts offer
GRACE_S = 5.0  # a claim is fenced when it was not renewed for so long beyond its lease
SILENCE_S = 5.0  # a host that has not beaten for so long is shown as lost
PINNED_S = 60.0  # a target of one host: its session may last as long as its contract, and this
ENFORCE_S = 0.5  # between two looks at the claims
RECORDS_MAX = 4096  # of a lane in one turn
HOMES_MAX = 4096  # episodes, the latest
_S = SessionState
_VERDICTS = {_S.SUCCEEDED: "accept", _S.FAILED: "refuse", _S.REPLANNED: "replan", _S.UNVERIFIED: "skip"}
_RESTING = frozenset({_S.PENDING, _S.AWAITING_VERIFICATION, _S.VERIFYING})  # these hold no resource
_SETTLED = frozenset({*FINAL_STATES, _S.AWAITING_VERIFICATION, _S.VERIFYING})  # no host can lose them any more
_ENDS_A_CANCEL = frozenset({"finish", "reject", "confirm_cancel"})


@dataclass(slots=True)
class Placed:
    """A session with an offer: its claim as seen last, and since when [s]."""

    offer: Offer
    claim: Stored | None = None
    since_s: float = 0.0


class FleetHub:
    """Call `turn` whenever there is news, and a few times a second.

    Args:
        workspace: The agent's; no watchdog supervises it.
        journal: Of that workspace, opened for the runtime's side.
        bus: To the server.
        clock: For leases, which count from when a renewal is seen here.
        lease_s: Of shared targets [s].
    """

    def __init__(
        self, workspace: Workspace, journal: Journal, bus: Bus, clock: Clock, *, lease_s: float = LEASE_S
    ) -> None:
        self._workspace, self._bus, self._clock, self._lease_s = workspace, bus, clock, lease_s
        self._own, self._ledger = journal, journal.open_ledger()
        self._journal = SupervisorJournal(journal, self._ledger, lambda _: None)
        self._operator = OperatorSignals(workspace, self._journal, clock)
        self._fetched = Transfers(bus, fetch_bundle)
        self._replicas: dict[str, LaneReplica] = {}
        self._waiting: dict[SessionId, deque[tuple[str, Record]]] = defaultdict(deque)  # by lane, not recorded here yet
        self._over: set[SessionId] = set()  # final in the lane of its host
        self._holders: dict[SessionId, str] = {}  # hosts that claimed them first: no other one may in their place
        self._placed: dict[SessionId, Placed] | None = None  # None: not read yet
        self._seen: dict[str, tuple[int, float]] = {}  # host -> beat, and since when [s]
        self._cards: list[HostCard] = []
        self._homes: dict[tuple[str, str], tuple[str, str]] = {}  # world and episode -> since when, and on which host
        targets = read_target_registry(workspace.target_registry)
        self._world_of = {name: each.world or name for name, each in targets.items()}
        self._aside: dict[str, str] = {}  # lanes that cannot be followed, and why
        self._health: dict[str, Health] = {}
        self._enforce_at_s = -float("inf")
        self._stopped_at = ""
        self._number = 0

    def turn(self) -> bool:
        """Do what is due; whether more waits. Without the server only the operator is listened to."""
        more = False
        self._journal.follow()
        self._operator.take(())
        self._operator.end_cancelled()
        if not self._bus.is_connected:  # silence means nothing while this side hears nothing
            self._placed, self._seen = None, {}
            return False
        with contextlib.suppress(BusLost):
            self._pass_stop_on()
        self._read_cards()
        with contextlib.suppress(BusLost):
            more = self._follow_lanes()
            self._relay()
        with contextlib.suppress(BusLost):
            if self._placed is None:
                self._placed = self._read_placed()
            offers = self._place(self._placed)
            self._enforce(self._placed)
            self._put(self._placed, offers)
        return more

    def close(self) -> None:
        """Close what it opened."""
        self._operator.close()
        for replica in self._replicas.values():
            replica.close()

    def get_replica_root(self, lane: str) -> Path:
        """Where the lane of a host is kept: a folder for `paos store check`."""
        return self._workspace.root / "fleet" / lane

    def _pass_stop_on(self) -> None:
        latch = read_latch(self._workspace.signals.parent) if self._operator.is_stopped() else None
        if latch is not None and latch.at != self._stopped_at:
            self._stopped_at = latch.at
            self._bus.put(Bucket.STOPS, "stop", msgspec.json.encode(latch))

    def _read_cards(self) -> None:
        """The hosts that have ever joined; the health of their targets is published."""
        self._cards = read_cards(self._bus.view(Bucket.HOSTS))
        now_s = self._clock.now_s()
        for card in self._cards:
            if self._seen.get(card.host, (-1, 0.0))[0] != card.beat:
                self._seen[card.host] = card.beat, now_s
        ready = {target for card in self._cards if self._is_alive(card) for target in card.targets}
        known = sorted({target for card in self._cards for target in card.targets} & self._world_of.keys())
        health = {target: Health.READY if target in ready else Health.LOST for target in known}
        if health != self._health:
            self._health, at = health, self._clock.wall_iso()
            now = {name: TargetHealth(state=each, since=at) for name, each in health.items()}
            publish_health(self._workspace.target_registry, now)

    def _is_alive(self, card: HostCard) -> bool:
        beats = card.host in self._seen and self._clock.now_s() - self._seen[card.host][1] < SILENCE_S
        return beats and card.host not in self._aside

    def _find_capable(self, session: Session) -> set[str]:
        """Hosts that are alive and can carry out this skill on this target."""
        return {card.host for card in self._cards if card.offers(session) and self._is_alive(card)}

    def _follow_lanes(self) -> bool:
        """Whether more waits; a lane that is damaged concerns its host alone."""
        wanted, more = dict[str, tuple[int, int]](), False
        for lane in {card.host for card in self._cards} - self._aside.keys():
            with self._set_aside(lane):
                if lane not in self._replicas:
                    self._replicas[lane] = LaneReplica(self.get_replica_root(lane), lane)
                    self._take_in(lane, self._replicas[lane].start)
                    self._replicas[lane].start.clear()
                end, before = self._bus.find_end(lane), self._replicas[lane].seq
                wanted |= {lane: (before, min(end, before + RECORDS_MAX))} if end > before else {}
        for lane, frames in (self._bus.read_all(wanted) if wanted else {}).items():
            with self._set_aside(lane):
                self._take_in(lane, self._replicas[lane].take(frames))
                more |= bool(frames) and self._replicas[lane].seq < self._bus.find_end(lane)
        return more

    @contextlib.contextmanager
    def _set_aside(self, lane: str) -> Iterator[None]:
        try:
            yield
        except ExecutionError as error:
            self._aside[lane] = str(error)

    def _take_in(self, lane: str, records: list[Record]) -> None:
        for record in records:
            id = SessionId(record.id)
            if record.to in FINAL_STATES:
                self._over.add(id)
            if record.side == Side.RUNTIME and record.source is not None:
                self._waiting[id].append((lane, record))

    def _relay(self) -> None:
        """Record here what hosts have recorded, each session up to where its evidence is missing."""
        for id in list(self._waiting):
            records = self._waiting[id]
            while records and self._relay_one(id, *records[0]):
                records.popleft()
            if not records:
                del self._waiting[id]

    def _relay_one(self, id: SessionId, lane: str, record: Record) -> bool:
        """Whether this record is done with: recorded, or not to be recorded here."""
        status = self._ledger.sessions.get(id)
        is_over = status is None or status.state in FINAL_STATES
        if status is not None and record.ev == CLAIM and (is_over or self._holds(lane, id)):
            self._note_home(status, lane)
        if status is None or is_over or not self._holds(lane, id):
            return True
        trigger, body = record.ev, dict(record.body or {})
        is_next = (status.state, status.epoch) == (record.source, (record.epoch or 0) - (trigger == CLAIM))
        if status.state == _S.CANCELLING and trigger in _ENDS_A_CANCEL:  # whatever ended it there
            trigger = "confirm_cancel"
        elif not is_next and not (status.state == _S.CANCELLING and trigger == "lose"):
            return True  # recorded before, or after it was fenced
        if isinstance(execution := body.get("execution"), dict):
            if not self._has_evidence(id, lane):
                return False
            body["execution"] = execution | {"evidence": f"evidence/{id}"}
        self._record([Entry(id, trigger, body or None, status.epoch)], record.by)
        return True

    def _note_home(self, status: SessionStatus, lane: str) -> None:
        """Another host has another world, in which nothing of this episode has happened; the latest by this clock."""
        target, episode = status.contract.target, status.contract.scene.episode
        key = self._world_of.get(target, target), episode
        self._homes[key] = max(self._homes.pop(key, ("", "")), (status.updated_at, lane))
        if len(self._homes) > HOMES_MAX:
            del self._homes[next(iter(self._homes))]

    def _holds(self, lane: str, id: SessionId) -> bool:
        """Whether the host of a lane has claimed a session, fenced since or not: another one has no say in it."""
        key = encode_key(id)
        if id not in self._holders:
            claim = read_claim(self._bus.view(Bucket.CLAIMS).get(key)) or Claim()
            if not claim.host:  # its lane may be faster than the news of its claim
                claim = read_claim(self._bus.get(Bucket.CLAIMS, key)) or Claim()
            self._holders |= {id: claim.host} if claim.host else {}
        return self._holders.get(id) == lane

    def _has_evidence(self, id: SessionId, lane: str) -> bool:
        """Whether its bundle is here; what is damaged comes no more, which the verdict shows."""
        try:
            return self._fetched.is_done(self._workspace.evidence_of(id), id, lane)
        except BusLost:
            raise
        except ExecutionError:
            return True

    def _record(self, entries: list[Entry], by: str) -> None:
        with contextlib.suppress(IllegalTransition, Fenced, DefinitionError):  # others were faster; or no such record
            self._own.commit(entries, durable=False, by=by)
        self._journal.follow(looks=False)

    def _read_placed(self) -> dict[SessionId, Placed]:
        """What was placed before, by this process or an earlier one."""
        offers = iter_read(self._bus.view(Bucket.OFFERS).values(), Offer)
        found = {each.contract.id: Placed(each, since_s=self._clock.now_s()) for each in offers}
        self._number = max((each.offer.number for each in found.values()), default=self._number)
        for status in list(self._ledger.live_sessions()):
            if status.contract.id not in found and status.state not in _RESTING:
                self._give_up(status, "", "the server does not know its claim any more")
        return found

    def _place(self, placed: dict[SessionId, Placed]) -> list[Offer]:
        """Offers of what waits, the senior first; resources are given to one session at a time."""
        waiting = list(self._ledger.iter_pending())
        held = [each.contract for each in self._ledger.live_sessions() if each.state not in _RESTING]
        held += [each.contract for each in waiting if each.contract.id in placed]
        taken = {name for each in held for name in each.resources}
        changed, new = list[Offer](), list[Session]()
        for session in (each.contract for each in waiting):
            if session.id in placed:
                offer = placed[session.id].offer
                changed += [wanted] if (wanted := self._update(offer, session)) != offer else []  # or was amended
            elif taken.isdisjoint(session.resources):
                taken.update(session.resources)
                new.append(session)
        return [*changed, *(self._open(new, placed) if new else ())]

    def _update(self, offer: Offer, session: Session) -> Offer:
        """As it should be now: the lease of a session that several hosts can take is short, else one may finish it."""
        limits, capable = session.limits, self._find_capable(session)
        key = self._world_of.get(session.target, session.target), session.scene.episode
        home, hosts = self._homes.get(key, ("", ""))[1], len(capable)
        pinned_s = limits.queue_s + limits.timeout_s + limits.wall_timeout_s + PINNED_S
        lease_s = self._lease_s if hosts > 1 else max(self._lease_s, pinned_s)
        return msgspec.structs.replace(
            offer, contract=session, lease_s=lease_s, hosts=hosts, home=home if home in capable else ""
        )

    def _open(self, sessions: list[Session], placed: dict[SessionId, Placed]) -> list[Offer]:
        """Offers of those whose claim is open: since now, or by an earlier process that ended before it offered it.

        Placed from here on: one whose answer is lost may have reached a host. Without a lease it is sent again.
        """
        self._own.sync()  # what a power cut could take back here must not stand elsewhere
        keys = {encode_key(each.id): each for each in sessions}
        opened = self._bus.open_all(Bucket.CLAIMS, dict.fromkeys(keys, msgspec.json.encode(Claim())))
        offers = []
        for key, session in keys.items():
            revision = opened[key]
            if revision is None and (found := self._bus.get(Bucket.CLAIMS, key)) is not None:
                revision = found.revision if read_claim(found) == Claim() else None
            if revision is None:
                taken = Problem(
                    "BUSY", f"{session.id}: the server has a claim of this name", expected="another goal id"
                )
                self._record([make_rejection(session.id, taken)], BY)
                continue
            self._number += 1
            offer = Offer(contract=session, number=self._number, revision=revision, lease_s=0.0)
            placed[session.id] = Placed(offer, since_s=self._clock.now_s())
            offers.append(self._update(offer, session))
        return offers

    def _enforce(self, placed: dict[SessionId, Placed]) -> None:
        """Fence what was not renewed in time, and what no host has taken in time."""
        claims, now_s = self._bus.view(Bucket.CLAIMS), self._clock.now_s()
        if now_s < self._enforce_at_s:
            return
        self._enforce_at_s = now_s + ENFORCE_S
        for id, each in placed.items():
            status = self._ledger.sessions.get(id)
            found = claims.get(encode_key(id))
            if status is None or status.state in _SETTLED or found is None:
                continue
            if found != each.claim:
                each.claim, each.since_s = found, now_s
            claim = read_claim(found) or Claim()
            host = self._holders.setdefault(id, claim.host) if claim.host else ""
            patience_s = claim.lease_s + GRACE_S if claim.host else status.contract.limits.queue_s
            is_late = now_s - each.since_s > patience_s or host in self._aside or host != claim.host
            if claim.is_fenced or (is_late and self._fence(id, found)):
                why = self._aside.get(host, f"host {host} did not renew its lease in time: lost, or cut off")
                self._give_up(status, host, why)

    def _fence(self, id: SessionId, seen: Stored) -> bool:
        """End the claim that was seen, unless it has changed; from here on no host may act under it."""
        claim = read_claim(seen) or Claim()
        fenced = msgspec.structs.replace(claim, epoch=claim.epoch + 1, is_fenced=True)
        return self._bus.swap(Bucket.CLAIMS, encode_key(id), msgspec.json.encode(fenced), seen.revision) is not None

    def _give_up(self, status: SessionStatus, host: str, why: str) -> None:
        id, state, epoch = status.contract.id, status.state, status.epoch
        if not host and state == _S.PENDING:
            limit = status.contract.limits.queue_s
            late = Problem("TIMED_OUT", f"{id}: limits.queue_s", expected=f"a host with a free target within {limit} s")
            self._record([make_rejection(id, late)], BY)
            return
        why = f"{why}; its effect is unknown"
        code = "HOST_LOST" if self._find_capable(status.contract) - {host} else "TARGET_LOST"
        lost = Execution(ended=Ended.TARGET_LOST, evidence=f"evidence/{id}", code=code, message=why)
        entries = [Entry(id, CLAIM, None, epoch)] if state == _S.PENDING else []
        epoch += len(entries)
        entries += [Entry(id, "check", None, epoch)] if state in {_S.PENDING, _S.CLAIMED} else []
        entries += [Entry(id, "lose", {"reason": why}, epoch)] if state != _S.OUTCOME_UNKNOWN else []
        body = {"execution": msgspec.to_builtins(lost)}
        self._record([*entries, Entry(id, "reconcile", body, epoch)], host or BY)

    def _put(self, placed: dict[SessionId, Placed], offers: list[Offer]) -> None:
        """Send these, let hosts know of verdicts and cancellations, and forget what is over on both sides.

        Placed is what the server has confirmed: the rest is sent again.
        """
        over, ended = [], []
        for id, each in placed.items():
            status = self._ledger.sessions.get(id)
            if (status is None or status.state in FINAL_STATES) and self._is_over_there(id):
                over.append(each.offer.contract)
            elif (wanted := _build_end(each.offer, status)) != each.offer:
                ended.append(wanted)
        if ended:
            self._own.sync()  # the verdicts that are passed on
        sent = {each.contract.id: each for each in (*offers, *ended)}
        values: dict[tuple[Bucket, str], bytes | None]
        values = {(Bucket.OFFERS, get_offer_key(each.contract)): msgspec.json.encode(each) for each in sent.values()}
        values |= {(Bucket.OFFERS, get_offer_key(each)): None for each in over}
        values |= {(Bucket.CLAIMS, encode_key(each.id)): None for each in over}
        if values:
            self._bus.put_all(values)
        for id, offer in sent.items():
            placed[id].offer = offer
        for contract in over:
            del placed[contract.id]
        self._fetched.forget_all_but(placed.keys())
        self._over &= placed.keys()
        self._holders = {id: host for id, host in self._holders.items() if id in placed}

    def _is_over_there(self, id: SessionId) -> bool:
        """Whether no host will do anything more about it."""
        if id in self._over:
            return True
        found = self._bus.view(Bucket.CLAIMS).get(encode_key(id))
        claim = read_claim(found) or Claim()
        return not claim.host and found is not None and (claim.is_fenced or self._fence(id, found))


def _build_end(offer: Offer, status: SessionStatus | None) -> Offer:
    """The offer as it should be now."""
    if status is None or offer.end:
        return offer
    state = SessionState(status.state)
    if state in _VERDICTS and status.decision is not None:
        verdict = EndEntry(_VERDICTS[state], {"attempt": msgspec.to_builtins(status.decision)})
        return msgspec.structs.replace(offer, end=(EndEntry("verify"), verdict))
    is_cancelled = state in {_S.CANCELLING, _S.CANCELLED}
    return msgspec.structs.replace(offer, is_cancelled=is_cancelled) if is_cancelled else offer
