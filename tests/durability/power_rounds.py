"""The power of a real ext4 goes while several processes write; round after round, in a process of its own.

    python -m tests.durability.power_rounds --cuts 1000 --mount ordered

Only where `real_disk` works. Three writers commit with the disk confirmed; at a random moment the file system is shut
down without a flush. What they had been told by then must stand when it is mounted again. A lane lives through several
cuts, so that recovery and repair are cut as well. Prints one JSON line of figures.
"""

import argparse
import json
import os
import random
import select
import shutil
import sys
import tempfile
from pathlib import Path

from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.follower import Follower
from phyagentos.store.journal import Journal

from . import second_reader
from .kill_rounds import Writer, wait_for_answers
from .real_disk import OPTIONS, RealDisk
from .workloads import LANE, identify

WRITERS = 3
CUTS_PER_WORKSPACE = 8
ANSWERS_PER_CUT = 40


class PowerRounds:
    """One file system, its power cut again and again."""

    def __init__(self, disk: RealDisk, seed: int) -> None:
        self.disk, self.rng, self.errors = disk, random.Random(seed), []
        names = ("cuts", "acknowledged", "lost", "refused", "repairs", "broken_batches", "readers_differ", "archived")
        self.counts = dict.fromkeys(names, 0)

    def run(self, cuts: int) -> None:
        while self.counts["cuts"] < cuts and not self.errors:
            root = self.disk.root / "w"
            root.mkdir()
            os.sync()  # the workspace itself is older than the accident
            told: dict[int, list] = {}
            for _ in range(min(CUTS_PER_WORKSPACE, cuts - self.counts["cuts"])):
                told |= self._write_until_the_cut(root)
                self.disk.restore()
                if not self._judge(root, told):
                    break
            self.counts["acknowledged"] += len(told)
            shutil.rmtree(root)

    def _write_until_the_cut(self, root: Path) -> dict[int, list]:
        number = self.counts["cuts"]
        writers = [Writer(root, f"c{number}w{each}", self.rng.getrandbits(32), durable=True) for each in range(WRITERS)]
        self.errors += wait_for_answers(writers, self.rng.randrange(1, ANSWERS_PER_CUT))
        select.select([], [], [], self.rng.random() * 0.002)
        for writer in writers:
            self.errors += writer.drain()
        told = {seq: identity for writer in writers for seq, identity in writer.told.items()}
        self.disk.cut()
        select.select([], [], [], 0.005)  # those in the middle of something find out
        for writer in writers:
            writer.kill()  # what it tells from now on reaches nobody
        self.counts["cuts"] += 1
        return told

    def _judge(self, root: Path, told: dict[int, list]) -> bool:
        """Count what is lost; whether the lane can be written again without a person's help."""
        try:
            late = Journal(root, side=Side.RUNTIME, by="late", partition=LANE, clock=SystemClock())
        except ExecutionError as error:
            self.counts["refused"] += 1
            if error.code != "JOURNAL_DAMAGED":
                self.errors.append(str(error))
            late = None
        else:
            late.close()
        follower = Follower(root / "sessions" / LANE)
        try:
            records = follower.advance()
        except ExecutionError:
            records = []
        finally:
            follower.close()
        stands = {record.seq: list(identify(record)) for record in records}
        self.counts["lost"] += sum(stands.get(seq) != identity for seq, identity in told.items())
        if late is not None:
            again = second_reader.read_lane(root, LANE)
            self.counts["repairs"] += sum(record.ev == "repair" and record.by == "late" for record in records[-1:])
            self.counts["broken_batches"] += second_reader.find_broken_batches(again)
            self.counts["readers_differ"] += list(stands.values()) != [
                list(second_reader.identify(each)) for each in again
            ]
            self.counts["archived"] += len(list(root.glob(f"sessions/archive/*/{LANE}/*.md")))
        return late is not None


def main() -> int:
    """Run the rounds and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cuts", type=int, default=30)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--mount", choices=OPTIONS, default="ordered")
    parser.add_argument("--scratch", type=Path, default=None)
    parser.add_argument("--no-sync", action="store_true", help="negative control: nothing waits for the disk")
    given = parser.parse_args()
    if given.no_sync:
        os.fsync = os.fdatasync = lambda _: None
    with (
        tempfile.TemporaryDirectory(prefix="power-", dir=given.scratch) as scratch,
        RealDisk(Path(scratch), OPTIONS[given.mount]) as disk,
    ):
        rounds = PowerRounds(disk, given.seed)
        rounds.run(given.cuts)
    sys.stdout.write(json.dumps({"counts": rounds.counts, "errors": rounds.errors}) + "\n")
    return 1 if rounds.errors else 0


if __name__ == "__main__":
    sys.exit(main())
