"""kill -9 of random writers, round after round, in a process of its own that forks them: a fork costs little.

    python -m tests.durability.kill_rounds --kills 20000 --seed 1

Four writers at a time commit batches, claims and releases into one lane with tiny segments. Their writes are split, and
they dawdle between two calls, so that a kill finds them in the middle of anything. What `commit` returned is told over
a pipe. A reader follows all the while; what it has seen must still stand at the end. Prints one JSON line of figures.
"""

import argparse
import json
import os
import random
import select
import shutil
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path

from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.lifecycle import IllegalTransition, Side
from phyagentos.store.follower import Follower
from phyagentos.store.history import fold
from phyagentos.store.journal import Entry, Fenced, Journal
from phyagentos.store.ledger import Ledger
from phyagentos.store.segments import SystemIO

from . import second_reader
from .workloads import LANE, identify, list_live, make_submit

WRITERS = 4
SEGMENT_BYTES = 12_000
KILLS_PER_WORKSPACE = 20
ANSWERS_PER_KILL = 14
PATIENCE_S = 60.0


class DawdlingIO(SystemIO):
    """Splits writes and lets others run between two calls, so that a writer is often in the middle of something."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng

    def _pause(self) -> None:
        if self._rng.random() < 0.2:
            select.select([], [], [], self._rng.random() * 0.002)

    def write(self, fd, data):
        self._pause()
        return super().write(fd, data[: self._rng.choice((20, 60, 300, 5000, 1 << 20))])

    def truncate(self, fd, size):
        super().truncate(fd, size)
        self._pause()

    def fsync(self, fd):
        self._pause()
        super().fsync(fd)

    def replace(self, source, destination):
        self._pause()
        super().replace(source, destination)
        self._pause()


def write_forever(root: Path, name: str, seed: int, pipe: int, *, durable: bool | None) -> None:
    """A writer: tells the identity of every acknowledged record, a line a commit."""
    rng, parent = random.Random(seed), os.getppid()
    side = rng.choice((Side.AGENT, Side.RUNTIME))
    journal = Journal(
        root,
        side=side,
        by=name,
        partition=LANE,
        clock=SystemClock(),
        durable=rng.random() < 0.5 if durable is None else durable,
        segment_bytes=SEGMENT_BYTES,
        file_io=DawdlingIO(rng),
    )
    ledger = journal.open_ledger()  # so it writes checkpoints and archives as well
    count = 0
    while os.getppid() == parent:  # nobody is left behind when the rounds are ended from outside
        ledger.extend(journal.read_new())
        if side is Side.AGENT:
            size = rng.choice((1, 1, 2, 5))
            entries = [
                make_submit(f"{name}-{count + number}", "y" * rng.choice((0, 40, 700))) for number in range(size)
            ]
            count += size
        else:
            entries = choose_runtime_entries(ledger, rng)
        try:
            told = [identify(record) for record in journal.commit(entries)]
        except (IllegalTransition, Fenced):
            continue  # somebody else was first
        os.write(pipe, json.dumps(told).encode() + b"\n")


def choose_runtime_entries(ledger: Ledger, rng: random.Random) -> list[Entry]:
    """Claims, or the end of the oldest sessions, whoever held them: so old segments can be archived."""
    pending = [status.contract.id for status in ledger.iter_pending()]
    held = [status for status in ledger.live_sessions() if status.state == "preflight"]
    if held and rng.random() < 0.6:
        body = {"reason": "z" * rng.choice((3, 900))}
        return [Entry(status.contract.id, "reject", body, status.epoch) for status in held[:3]]
    chosen = rng.sample(pending, min(len(pending), rng.choice((1, 3))))
    return [Entry(id, event) for id in chosen for event in ("claim", "check")]


class Writer:
    """A forked writer and what it has told; by default chance decides whether it waits for the disk."""

    def __init__(self, root: Path, name: str, seed: int, *, durable: bool | None = None) -> None:
        self.told: dict[int, list] = {}
        self.has_ended = False
        self.answers = 0  # an idle one commits nothing, and says so
        self._rest = b""
        self._pipe, theirs = os.pipe()
        self.pid = os.fork()
        if self.pid == 0:
            try:
                write_forever(root, name, seed, theirs, durable=durable)
            except ExecutionError as error:
                os.write(theirs, json.dumps({"error": str(error)}).encode() + b"\n")
            except BaseException:
                os.write(theirs, json.dumps({"error": traceback.format_exc()}).encode() + b"\n")
            finally:
                os._exit(1)
        os.close(theirs)
        os.set_blocking(self._pipe, False)

    def kill(self) -> list[str]:
        """Kill it; errors it had told before."""
        os.kill(self.pid, signal.SIGKILL)
        os.waitpid(self.pid, 0)
        errors = self.drain()
        os.close(self._pipe)
        return errors

    def drain(self) -> list[str]:
        errors = []
        while True:
            try:
                part = os.read(self._pipe, 1 << 16)
            except BlockingIOError:
                break
            if not part:
                self.has_ended = True
                break
            *lines, self._rest = (self._rest + part).split(b"\n")
            for line in lines:
                answer = json.loads(line)
                if isinstance(answer, dict):
                    errors.append(answer["error"])
                else:
                    self.answers += 1
                    self.told |= {identity[0]: identity for identity in answer}
        return errors


def wait_for_answers(writers: list[Writer], count: int) -> list[str]:
    """Let writers return from so many commits, however slow this machine is today; errors they tell meanwhile."""
    awaited, end = sum(writer.answers for writer in writers) + count, time.perf_counter() + PATIENCE_S
    errors: list[str] = []
    while sum(writer.answers for writer in writers) < awaited and not errors:
        for writer in writers:
            errors += writer.drain()
        if all(writer.has_ended for writer in writers):
            errors.append("the writers have ended by themselves")
        if time.perf_counter() > end:
            errors.append(f"{len(writers)} writers did not return from {count} commits in {PATIENCE_S} s")
        select.select([], [], [], 0.0003)
    return errors


class Rounds:
    """Workspaces in which writers die, and what was found in them."""

    def __init__(self, scratch: Path, seed: int) -> None:
        self.scratch, self.rng, self.errors = scratch, random.Random(seed), []
        self.counts = dict.fromkeys(
            (
                "kills",
                "acknowledged",
                "lost",
                "vanished",
                "broken_batches",
                "repairs",
                "segments",
                "archived",
                "workspaces",
                "readers_differ",
                "folds_differ",
            ),
            0,
        )

    def run(self, kills: int) -> None:
        while self.counts["kills"] < kills and not self.errors:
            root = self.scratch / f"w{self.counts['workspaces']}"
            self._run_workspace(root, min(KILLS_PER_WORKSPACE, kills - self.counts["kills"]))
            shutil.rmtree(root)

    def _run_workspace(self, root: Path, kills: int) -> None:
        first = Journal(root, side=Side.AGENT, by="first", partition=LANE, clock=SystemClock(), durable=False)
        first.close()
        follower, seen, told = Follower(root / "sessions" / LANE), {}, {}
        writers = [self._start(root, number) for number in range(WRITERS)]
        for number in range(kills):
            self.errors += wait_for_answers(writers, self.rng.randrange(ANSWERS_PER_KILL))
            select.select([], [], [], self.rng.random() * 0.002)
            try:
                seen |= {record.seq: list(identify(record)) for record in follower.read_new()}
            except ExecutionError as error:
                self.errors.append(str(error))
            if self.errors:
                break
            index = self.rng.randrange(WRITERS)
            self.errors += writers[index].kill()
            told |= writers[index].told
            self.counts["kills"] += 1
            writers[index] = self._start(root, WRITERS + number)
        for writer in writers:
            self.errors += wait_for_answers([writer], 1)  # the survivors must get on
            self.errors += writer.kill()
            told |= writer.told
        follower.close()
        self._judge(root, told, seen)

    def _start(self, root: Path, number: int) -> Writer:
        return Writer(root, f"w{number}", self.rng.getrandbits(32))

    def _judge(self, root: Path, told: dict[int, list], seen: dict[int, list]) -> None:
        follower = Follower(root / "sessions" / LANE)
        try:
            late = Journal(root, side=Side.RUNTIME, by="late", partition=LANE, clock=SystemClock(), durable=False)
            ledger = late.open_ledger()
            late.close()
            records = follower.read_new()
        except ExecutionError as error:
            self.errors.append(str(error))
            return
        finally:
            follower.close()
        self.counts["folds_differ"] += list_live(ledger) != list_live(fold(records))
        self.counts["archived"] += len(list(root.glob(f"sessions/archive/*/{LANE}/*.md")))
        stands = {record.seq: list(identify(record)) for record in records}
        again = second_reader.read_lane(root, LANE)
        self.counts["acknowledged"] += len(told)
        self.counts["lost"] += sum(stands.get(seq) != identity for seq, identity in told.items())
        self.counts["vanished"] += sum(stands.get(seq) != identity for seq, identity in seen.items())
        self.counts["broken_batches"] += second_reader.find_broken_batches(again)
        self.counts["readers_differ"] += list(stands.values()) != [list(second_reader.identify(each)) for each in again]
        self.counts["repairs"] += sum(record.ev == "repair" for record in records)
        self.counts["workspaces"] += 1
        self.counts["segments"] += len(second_reader.find_segments(root, LANE))


def main() -> int:
    """Run the rounds and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scratch", type=Path, default=None)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="kills-", dir=given.scratch) as scratch:
        rounds = Rounds(Path(scratch), given.seed)
        rounds.run(given.kills)
    sys.stdout.write(json.dumps({"counts": rounds.counts, "errors": rounds.errors}) + "\n")
    return 1 if rounds.errors else 0


if __name__ == "__main__":
    sys.exit(main())
