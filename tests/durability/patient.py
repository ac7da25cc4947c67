"""A lane that is damaged and healed again and again, and what its readers say meanwhile."""

from collections import Counter

from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.follower import Follower
from phyagentos.store.journal import Journal
from phyagentos.store.records import Tail

from . import damages, second_reader
from .workloads import LANE, Bench, identify

WORKLOAD = ("submit", "batch", "claim", "rotate", "batch", "claim", "submit", "rotate", "submit", "batch")


class Patient:
    """A lane of three segments, damaged and healed again and again."""

    def __init__(self, root, workload=WORKLOAD):
        self.root, self.folder = root, root / "sessions" / LANE
        bench = Bench(root, durable=False)
        for name in workload:
            bench.run(name)
        bench.close()
        self.clock = bench.clock
        self.told = list(bench.told.values())
        self.paths = second_reader.find_segments(root, LANE)
        self.whole = {path: path.read_bytes() for path in self.paths}
        self.counts = Counter(
            dict.fromkeys(("damages", "located", "cut", "harmless", "accepted", "beyond_the_damage"), 0)
        )
        self.accepted = []

    def suffer(self, damage, *, opens_journal):
        """Damage one file, look, and heal it."""
        damage.path.write_bytes(damage.data)
        try:
            found, tail, message = self.follow()
            outcome = self._judge(damage, [identify(record) for record in found], tail, message)
            if opens_journal:
                assert self._judge_journal(damage) == outcome, (damage.kind, damage.path.name, damage.offset)
        finally:
            self.heal()
        self.counts.update(("damages", outcome))
        if outcome in {"accepted", "beyond_the_damage"}:
            self.accepted.append(f"{outcome}: {damage.kind} at {damage.path.name}, {damage.offset}: {message}")

    def follow(self):
        """Records, the tail, and the message of the damage, of a reader that begins at the first record."""
        follower, found = Follower(self.folder), []
        try:
            found += follower.advance()
            follower.read_new()
        except ExecutionError as error:
            if error.code != "JOURNAL_DAMAGED":
                raise
            return found, follower.tail, str(error)
        finally:
            follower.close()
        return found, follower.tail, ""

    def _judge(self, damage, found, tail, message):
        is_prefix = found == self.told[: len(found)]
        if message:
            place, index = damages.find_place(message), self.paths.index(damage.path)
            assert place is not None, message
            is_before = (self._index(place[0]), place[1]) <= (index, damage.offset)
            return "accepted" if not is_prefix else "located" if is_before else "beyond_the_damage"
        if found == self.told and tail is Tail.CLEAN:
            return "harmless"
        is_last = damage.path == self.paths[-1]
        torn = is_last and damages.may_be_torn(self.whole[damage.path], damage.data)
        return "cut" if is_prefix and torn else "accepted"

    def _judge_journal(self, damage):
        """The same, asked of a writer; one that cuts goes on, and says what it cut."""
        try:
            journal = self.open()
        except ExecutionError as error:
            return self._judge(damage, [], Tail.DAMAGED, str(error))
        stands = journal.read_new()
        journal.close()
        repairs = [record for record in stands if record.ev == "repair"]
        found = [identify(record) for record in stands if record.ev != "repair"]
        return self._judge(damage, found, Tail.TORN if repairs else Tail.CLEAN, "")

    def open(self):
        """A writer."""
        return Journal(self.root, side=Side.RUNTIME, by="late", partition=LANE, clock=self.clock, durable=False)

    def _index(self, name):
        return [path.stem for path in self.paths].index(name)

    def heal(self):
        """As it was."""
        for path in self.folder.iterdir():
            if path not in self.whole:
                path.unlink()
        for path, data in self.whole.items():
            path.write_bytes(data)
