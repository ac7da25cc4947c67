"""Lanes side by side, each a process that is watched: what hangs is ended, what dies is counted, the rest goes on."""

import contextlib
import itertools
import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.unseen_parts.lane import draw_table
from benchmarks.unseen_parts.records import GoalRecord, begin_record, iter_findings

CHUNK = 10  # goals of one warm plane
START_S = 180.0  # a lane begins its first goal within this
END_S = 30.0  # and ends within this


@dataclass(slots=True)
class _Lane:
    """The goals of one lane, and where it writes."""

    seeds: list[int]
    table: str
    sense: str
    folder: Path
    keeps: bool
    wall_s: float
    done: "queue.Queue[GoalRecord | None]"
    command: tuple[str, ...]
    number: "itertools.count[int]" = field(default_factory=itertools.count)

    def run(self) -> None:
        """Chunk by chunk, until every seed has its record."""
        try:
            while self.seeds:
                chunk = self.seeds[:CHUNK]
                folder = self.folder / f"chunk-{next(self.number)}"
                shutil.rmtree(folder, ignore_errors=True)
                folder.mkdir(parents=True)
                records = list(self._run_chunk(folder, chunk))
                self.seeds = [seed for seed in self.seeds if seed not in {record.seed for record in records}]
                if not self.keeps and not any(True for record in records for _ in iter_findings(record)):
                    shutil.rmtree(folder, ignore_errors=True)
        finally:
            self.done.put(None)

    def _run_chunk(self, folder: Path, chunk: list[int]) -> Iterator[GoalRecord]:
        """The records of one process; it is ended when a goal crashes it or hangs."""
        command = [*self.command, str(folder), self.table, self.sense]
        with (folder / "lane.log").open("wb") as log:
            process = subprocess.Popen(
                [*command, *map(str, chunk)], stdout=subprocess.PIPE, stderr=log, start_new_session=True
            )
        lines: queue.Queue[dict[str, Any] | None] = queue.Queue()
        threading.Thread(target=_read_lines, args=(process, lines), daemon=True).start()
        begun, left_s = chunk[0], START_S + self.wall_s
        while True:
            try:
                line = lines.get(timeout=left_s)
            except queue.Empty:
                yield self._tell(begun, ended="hung", wall_s=left_s)
                break
            if line is None:
                log_tail = (folder / "lane.log").read_text(errors="replace")[-2000:]
                yield self._tell(begun, ended="crashed", error=f"the lane ended by itself: {log_tail}")
                break
            if "begun" in line:
                begun, left_s = line["begun"], self.wall_s
                continue
            record = GoalRecord.from_json(line["done"])
            self.done.put(record)
            yield record
            if record.seed == chunk[-1]:
                _wait(process)
                break
            if record.ended != "over":
                break  # a fresh process runs what is left
        _kill(process)

    def _tell(self, seed: int, **rest: Any) -> GoalRecord:
        """The record of a goal that its process could not judge."""
        record = begin_record(draw_table(seed, self.table), self.table, **rest)
        self.done.put(record)
        return record


def _read_lines(process: "subprocess.Popen[bytes]", lines: "queue.Queue[dict[str, Any] | None]") -> None:
    assert process.stdout is not None
    with process.stdout as output:
        for line in output:
            if line.startswith(b"{"):
                lines.put(json.loads(line))
    lines.put(None)


def _wait(process: "subprocess.Popen[bytes]") -> None:
    """A lane that is done ends its runtime plane, and then itself."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(timeout=END_S)


def _kill(process: "subprocess.Popen[bytes]") -> None:
    """End a lane; the kernel ends its runtime plane with it."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def run_lanes(
    seeds: Sequence[int],
    table: str,
    sense: str,
    work: Path,
    jobs: int,
    wall_s: float,
    *,
    keeps: bool = False,
    command: tuple[str, ...] = (sys.executable, "-m", "benchmarks.unseen_parts.lane"),
) -> Iterator[GoalRecord]:
    """Every seed's record, in the order in which the goals end.

    Args:
        seeds: Of the goals.
        table: Which friction.
        sense: `perceived` or `truth`.
        work: Folder of the workspaces; those without findings are deleted unless `keeps`.
        jobs: Lanes side by side.
        wall_s: Longest wall time of one goal [s].
        keeps: Whether every workspace stays.
        command: What runs a lane; it gets a folder, the table, the sensing and the seeds.
    """
    done: queue.Queue[GoalRecord | None] = queue.Queue()
    lanes = [
        _Lane(list(seeds[index::jobs]), table, sense, work / f"lane-{index}", keeps, wall_s, done, command)
        for index in range(jobs)
    ]
    for lane in lanes:
        threading.Thread(target=lane.run, daemon=True).start()
    for _ in lanes:
        while (record := done.get()) is not None:
            yield record
