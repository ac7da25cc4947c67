"""What the fault tests do to a journal: short commands, and a memory of what was acknowledged."""

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Scene, Session
from phyagentos.store.journal import Entry, Journal
from phyagentos.store.ledger import Ledger
from phyagentos.testing import ManualClock

LANE = "lane"
DAY_S = 86_400.0
UPKEEP_S = 3600.0  # more than any pause that the store makes between two checkpoints
NOON_S = 1_000_000.0  # some time on 1970-01-12


def make_submit(id: str, note: str = "") -> Entry:
    contract = Session(
        id=id,
        goal="goal",
        node="node",
        objective=f"Put the red cube into the red tray. {note}",
        skill="pick_and_place",
        target="panda",
        parameters={"object": "red_cube"},
        accept=("inside(red_cube, red_tray)",),
        scene=Scene(name="tabletop/cubes_and_trays", seed=7, episode="goal"),
        seed=7,
    )
    return Entry(id, "submit", msgspec.to_builtins(contract))


def identify(record) -> tuple[int, str, str, int | None, str]:
    """What must not change about a record, short."""
    digest = hashlib.sha256(f"{record.at} {record.by} {record.to} {record.markdown}".encode()).hexdigest()
    return record.seq, record.id, record.ev, record.epoch, digest[:16]


def list_live(ledger: Ledger) -> list[tuple]:
    return [(status.contract, status.state, status.epoch, status.claimed_by) for status in ledger.live_sessions()]


class Bench:
    """An agent and a runtime on one lane, and everything they were told stands.

    Attributes:
        told: Identities of acknowledged records, by sequence number.
        last_side: Who committed last, or tried to.
    """

    def __init__(self, root: Path, tell: Callable[[Sequence], None] = lambda _: None, **options) -> None:
        self.root, self.clock = root, ManualClock(NOON_S)
        self.told: dict[int, tuple] = {}
        self._tell, self._options = tell, {"durable": True, "partition": LANE, "clock": self.clock} | options
        self._journals: dict[Side, Journal] = {}
        self._submitted: list[str] = []
        self._ledger: Ledger | None = None
        self._claimed = self._named = 0

    def open(self, side: Side) -> Journal:
        if side not in self._journals:
            self._journals[side] = Journal(self.root, side=side, by=str(side), **self._options)
        return self._journals[side]

    def find(self, side: Side) -> Journal | None:
        return self._journals.get(side)

    def commit(self, side: Side, entries: Sequence[Entry]) -> None:
        self.last_side = side
        self._take(self.open(side).commit(entries))

    def close(self, side: Side | None = None) -> None:
        """End the process of this side, or both."""
        for each in [side] if side else list(self._journals):
            self._journals.pop(each).close()
            self._ledger = self._ledger if each is not Side.AGENT else None

    def submit(self) -> None:
        self._submit(1)

    def batch(self) -> None:
        """Three records, and longer than two sectors of a disk."""
        self._submit(3)

    def claim(self) -> None:
        """Claim a session; submit one first when none is left."""
        if self._claimed == len(self._submitted):
            self._submit(1)
        self._claimed += 1
        id = self._submitted[self._claimed - 1]
        self.commit(Side.RUNTIME, [Entry(id, "claim"), Entry(id, "check")])

    def rotate(self) -> None:
        """A new day: the next record begins a segment."""
        self.clock.advance(DAY_S)
        self._submit(1)

    def defer(self) -> None:
        """Leave the wait for the disk to somebody else's commit, in a new segment at that, and to a later `sync`."""
        first, second = self._draw_ids(2)
        agent = self.open(Side.AGENT)
        self.last_side = Side.AGENT
        waiting = agent.commit([make_submit(first)], durable=False)
        self.clock.advance(DAY_S)
        self.commit(Side.RUNTIME, [Entry(first, "claim"), Entry(first, "check")])
        self._take(waiting)
        self.last_side = Side.AGENT
        waiting = agent.commit([make_submit(second)], durable=False)
        agent.sync()
        self._take(waiting)
        self._submitted = [first, *self._submitted, second]
        self._claimed += 1

    def checkpoint(self) -> None:
        """Let the agent fold everything, and a minute pass, after which it writes a checkpoint."""
        self.last_side = Side.AGENT
        journal = self.open(Side.AGENT)
        if self._ledger is None:
            self._ledger = journal.open_ledger()
        self.clock.advance(UPKEEP_S)
        self._ledger.extend(journal.read_new())  # makes sure that the ledger is up to date
        self.clock.advance(UPKEEP_S)
        journal.read_new()

    def archive(self) -> None:
        """End all that is live and begin a segment, so that the one before it is no longer needed."""
        if waiting := self._submitted[self._claimed :]:
            self.commit(Side.AGENT, [Entry(id, "cancel", {"reason": "enough"}) for id in waiting])
            del self._submitted[self._claimed :]
        while self._submitted:
            self.commit(Side.RUNTIME, [Entry(self._submitted[0], "reject", {"reason": "enough"})])
            del self._submitted[0]
            self._claimed -= 1
        self.rotate()
        self.checkpoint()

    def run(self, name: str) -> None:
        getattr(self, name)()

    def _take(self, records: Sequence) -> None:
        """From now on these stand."""
        self.told |= {record.seq: identify(record) for record in records}
        self._tell(records)

    def _draw_ids(self, count: int) -> list[str]:
        self._named += count
        return [f"s{number}" for number in range(self._named - count, self._named)]

    def _submit(self, count: int) -> None:
        ids = self._draw_ids(count)
        self.commit(Side.AGENT, [make_submit(id, "x" * (300 * number)) for number, id in enumerate(ids)])
        self._submitted += ids


COMMANDS = ("submit", "claim", "batch", "rotate", "checkpoint", "archive", "defer")
