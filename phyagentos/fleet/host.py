"""A host of a fleet: it takes sessions for its own targets, and lets its own workspace carry them out.

Its watchdog sees ordinary sessions. Whatever is decided here rests on the journal of this host and on the server alone,
so that a process which is killed at any point goes on from both.
"""

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import msgspec

from phyagentos.clock import Clock
from phyagentos.errors import ExecutionError
from phyagentos.fleet.bundles import Transfers, send_bundle
from phyagentos.fleet.bus import Bucket, Bus, BusLost, Claim, HostCard, Offer, Stored, encode_key, find_read, read_claim
from phyagentos.fleet.lanes import LanePublisher
from phyagentos.protocol.sessions.estop import Latch, is_latched, latch
from phyagentos.protocol.sessions.lease_files import ENDED_S, remove_lease, write_lease
from phyagentos.protocol.sessions.lifecycle import (
    FINAL_STATES,
    UNJUDGED_STATES,
    Fenced,
    IllegalTransition,
    SessionState,
    find_cancel,
)
from phyagentos.protocol.sessions.session import SessionId, SessionStatus
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.journal import Entry, Journal

BY = "fleet"  # who submits in the journal of a host
BEAT_S = 1.0
RENEWALS = 0.2  # a lease is renewed when this share of it has passed
PRECEDENCE_S = 0.1  # a host that holds sessions waits for so long with each, so that a free one takes the next


@dataclass(slots=True)
class HeldClaim:
    """A claim of this host, as it was stored last; renewed at a time of this clock [s]."""

    claim: Claim
    revision: int
    renew_at_s: float


class FleetHost:
    """One host; call `turn` whenever there is news, and a few times a second.

    Args:
        workspace: Its own, supervised by a watchdog of its own.
        journal: Of that workspace, opened for the agent's side by `BY`.
        bus: To the server.
        clock: For leases; wall clocks play no part.
        targets: Those that it runs, with the skills that they can carry out.
        page: Where people find the page of its workspace.
    """

    def __init__(
        self,
        workspace: Workspace,
        journal: Journal,
        bus: Bus,
        clock: Clock,
        targets: Mapping[str, tuple[str, ...]],
        page: str = "",
    ) -> None:
        self._workspace, self._journal, self._bus, self._clock = workspace, journal, bus, clock
        self._leases = workspace.leases
        self._ledger = journal.open_ledger()
        self._publisher = LanePublisher(journal, bus)
        self._card = HostCard(host=journal.folder.name, targets=dict(targets), page=page)
        self._beat_at_s = -float("inf")
        self._held: dict[SessionId, HeldClaim] = {}
        self._transfers = Transfers(bus, send_bundle)
        self._offers: dict[bytes, tuple[Offer | None, float]] = {}  # and since when they are seen [s]
        self._lost: set[tuple[SessionId, int]] = set()  # claims that another host took, by their revision
        for status in self._iter_placed():  # leases of an earlier process, maybe before the machine started anew
            write_lease(self._leases, status.contract.id, ENDED_S)
        bus.on_change(Bucket.STOPS, self._stop)

    def turn(self) -> bool:
        """Do what is due, leases first, each part whatever becomes of the others; whether more waits."""
        more = False
        self._ledger.extend(self._journal.read_new())
        with contextlib.suppress(BusLost):
            self._renew()
        with contextlib.suppress(BusLost):
            self._announce()
        with contextlib.suppress(BusLost):
            more = self._publisher.publish(self._ledger.seq)
        with contextlib.suppress(BusLost):
            self._follow_offers()
        return more

    def _announce(self) -> None:
        if self._clock.now_s() < self._beat_at_s or not self._bus.is_connected:
            return
        found = self._bus.get(Bucket.HOSTS, encode_key(self._card.host)) if not self._card.beat else None
        if found is not None and (other := find_read(found.value, HostCard)) is not None:
            self._refuse_twin(other)
        for given in self._bus.view(Bucket.STOPS).values():  # one that was given while this host was away
            with contextlib.suppress(OSError):  # on a full disk again at the next beat
                self._stop(given.value)
        self._card = msgspec.structs.replace(
            self._card,
            beat=self._card.beat + 1,
            load=len([*self._iter_placed()]),
            is_stopped=is_latched(self._workspace.signals.parent),
        )
        self._bus.put(Bucket.HOSTS, encode_key(self._card.host), msgspec.json.encode(self._card))
        self._beat_at_s = self._clock.now_s() + BEAT_S

    def _refuse_twin(self, other: HostCard) -> None:
        """Another process of this name that still beats excludes this one."""
        self._clock.sleep(2.0 * BEAT_S)
        found = self._bus.get(Bucket.HOSTS, encode_key(self._card.host))
        again = find_read(found.value, HostCard) if found is not None else None
        if again is not None and again.beat != other.beat:
            raise ExecutionError(
                "BUSY", f"another host of the name {again.host!r} is in this fleet: use another --name"
            )

    def _iter_placed(self) -> Iterator[SessionStatus]:
        return (each for each in self._ledger.live_sessions() if each.asked_by == BY)

    def _follow_offers(self) -> None:
        found, now_s = {each.value for each in self._bus.view(Bucket.OFFERS).values()}, self._clock.now_s()
        new = {each: (find_read(each, Offer), now_s) for each in found if each not in self._offers}
        self._offers = {each: seen for each, seen in (self._offers | new).items() if each in found}
        mine = [(offer, at_s) for offer, at_s in self._offers.values() if offer and self._card.offers(offer.contract)]
        self._lost &= {(offer.contract.id, offer.revision) for offer, _ in mine}
        self._transfers.forget_all_but({offer.contract.id for offer, _ in mine})
        for offer, at_s in sorted(mine, key=lambda each: (-each[0].contract.priority, each[0].number)):
            id = offer.contract.id
            status = self._ledger.sessions.get(id)
            if status is not None:
                self._follow(status, offer)
            elif now_s >= at_s + self._find_delay(offer) and self._may_take(offer) and not self._journal.knows(id):
                self._take(offer)

    def _find_delay(self, offer: Offer) -> float:
        """For how long this host leaves an offer to another one, the longer the more it does [s]."""
        load = sum(each.state not in UNJUDGED_STATES for each in self._iter_placed())
        return PRECEDENCE_S * load if offer.hosts > 1 and not offer.home else 0.0

    def _may_take(self, offer: Offer) -> bool:
        """Whether it may go on here, its target is free, and neither end nor stop was requested."""
        held = (each for each in self._ledger.live_sessions() if each.state not in UNJUDGED_STATES)
        is_held = any(each.contract.target == offer.contract.target for each in held)
        is_elsewhere = offer.home not in {"", self._card.host}
        return not (
            is_held or is_elsewhere or offer.end or offer.is_cancelled or is_latched(self._workspace.signals.parent)
        )

    def _take(self, offer: Offer) -> None:
        """Claim a session; only the holder of the claim submits it to its own watchdog, under the lease."""
        id, begun_s = offer.contract.id, self._clock.now_s()
        if (id, offer.revision) in self._lost:
            return
        if not self._hold(id, Claim(epoch=1, lease_s=offer.lease_s), offer.revision):
            self._lost.add((id, offer.revision))
            return
        write_lease(self._leases, id, begun_s + offer.lease_s)
        self._journal.commit([Entry(id, "submit", dict(msgspec.to_builtins(offer.contract)))])
        self._ledger.extend(self._journal.read_new(looks=False))

    def _hold(self, id: SessionId, claim: Claim, revision: int) -> bool:
        """Store a claim in place of a revision, or of one of this host whose answer was lost; whether it is ours."""
        key = encode_key(id)
        stored = self._bus.swap(Bucket.CLAIMS, key, msgspec.json.encode(claim), revision)
        if stored is None and (found := self._find_own(key)) is not None:
            claim = msgspec.structs.replace(claim, beat=found[0].beat + 1)
            stored = self._bus.swap(Bucket.CLAIMS, key, msgspec.json.encode(claim), found[1].revision)
        if stored is not None:
            self._held[id] = HeldClaim(claim, stored, self._clock.now_s() + RENEWALS * claim.lease_s)
        return stored is not None

    def _find_own(self, key: str) -> tuple[Claim, Stored] | None:
        """The claim as the server has it, while it is of this host and not fenced."""
        found = self._bus.get(Bucket.CLAIMS, key)
        claim = read_claim(found)
        is_own = claim is not None and claim.host == self._card.host and not claim.is_fenced
        return (claim, found) if claim is not None and found is not None and is_own else None

    def _renew(self) -> None:
        for id, held in list(self._held.items()):
            status = self._ledger.sessions.get(id)
            if status is None or status.state in FINAL_STATES:
                del self._held[id]
                remove_lease(self._leases, id)
            elif (now_s := self._clock.now_s()) >= held.renew_at_s:
                claim = msgspec.structs.replace(held.claim, beat=held.claim.beat + 1)
                if self._hold(id, claim, held.revision):
                    write_lease(self._leases, id, now_s + claim.lease_s)
                else:
                    self._give_up(status)

    def _give_up(self, status: SessionStatus) -> None:
        """The hub has fenced it: the lease ends now, and the watchdog brings the target to rest."""
        write_lease(self._leases, status.contract.id, ENDED_S)
        self._held.pop(status.contract.id, None)
        self._cancel(status, "fenced: the hub has given this session up")

    def _follow(self, status: SessionStatus, offer: Offer) -> None:
        """Bring a session of this host on as the hub wants it, and its evidence there."""
        id = status.contract.id
        if status.execution is not None:
            self._transfers.is_done(self._workspace.evidence_of(id), id)
        if status.state in FINAL_STATES:
            return
        if id not in self._held and not offer.end and not self._hold_again(status, offer):
            return
        if offer.end and status.state == SessionState.AWAITING_VERIFICATION:
            self._commit([Entry(id, each.trigger, each.body or None) for each in offer.end])
        elif offer.is_cancelled or offer.end:
            self._cancel(status, "requested in the fleet")

    def _hold_again(self, status: SessionStatus, offer: Offer) -> bool:
        """After a start of this process: whether the claim is still ours; its lease begins anew."""
        id, now_s = status.contract.id, self._clock.now_s()
        found = self._find_own(encode_key(id))
        if found is None:
            self._give_up(status)
            return False
        claim = msgspec.structs.replace(found[0], beat=found[0].beat + 1)
        if self._hold(id, claim, found[1].revision):
            write_lease(self._leases, id, now_s + offer.lease_s)
        return id in self._held

    def _cancel(self, status: SessionStatus, reason: str) -> None:
        trigger = find_cancel(status.state)
        if trigger is not None:
            self._commit([Entry(status.contract.id, trigger, {"reason": reason})])

    def _commit(self, entries: list[Entry]) -> None:
        with contextlib.suppress(IllegalTransition, Fenced):  # the watchdog was faster: the next turn decides anew
            self._journal.commit(entries)
        self._ledger.extend(self._journal.read_new())

    def _stop(self, value: bytes) -> None:
        """Latch the emergency stop here, once for each that is given, readable or not; this host alone resets it."""
        seen = self._leases.parent / "fleet-stop"
        if not (seen.exists() and seen.read_bytes() == value):
            latch(self._workspace.signals.parent, find_read(value, Latch) or Latch(reason="a stop that cannot be read"))
            seen.parent.mkdir(parents=True, exist_ok=True)
            seen.write_bytes(value)
            self._beat_at_s = -float("inf")
            self._bus.ring()
