"""How long a durable transition takes, beside the disk's own wait, with more and more sessions stored before it."""

import itertools
import os
import statistics
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from phyagentos.store.journal import Entry, Journal

from .sessions import claim, finish, open_pair, start, submit, verdict

WINDOW = 60  # transitions, then as many bare waits, so that both meet the same disk


class Stage:
    """One lane, and the next transition in it."""

    def __init__(self, root: Path) -> None:
        self._agent, self._runtime = open_pair(root, durable=True)
        self._runtime.open_ledger()
        self._steps = self._iter_steps()
        self.times_s: list[float] = []

    def _iter_steps(self) -> "itertools.chain[tuple[Journal, Entry]]":
        agent, runtime = self._agent, self._runtime
        lives = (
            [
                (agent, submit(id)),
                (runtime, claim(id)),
                *((runtime, entry) for entry in (*start(id), *finish(id))),
                *((agent, entry) for entry in verdict(id)),
            ]
            for id in (f"new{number}" for number in itertools.count())
        )
        return itertools.chain.from_iterable(lives)

    def run_window(self) -> None:
        """Some transitions, each durable by itself."""
        for journal, entry in itertools.islice(self._steps, WINDOW):
            begin_s = time.perf_counter()
            journal.commit([entry])
            self.times_s.append(time.perf_counter() - begin_s)

    def close(self) -> None:
        """Let go of the lane."""
        self._agent.close()
        self._runtime.close()


def measure_transitions(roots: Mapping[int, Path], windows: int) -> tuple[dict[str, float], list[Sequence[str]]]:
    """Figures, and a row for each number of stored sessions.

    Args:
        roots: Stored sessions -> workspace.
        windows: How often each is visited, in turns.
    """
    stages = {stored: Stage(root) for stored, root in roots.items()}
    bare_s: list[float] = []
    ratios: dict[int, list[float]] = {stored: [] for stored in stages}
    growths: list[float] = []
    with (next(iter(roots.values())) / "bare").open("ab", buffering=0) as file:
        for _ in range(windows):
            medians: dict[int, float] = {}
            for stored, stage in stages.items():
                waits = [_wait_once(file.fileno()) for _ in range(WINDOW)]
                stage.run_window()
                medians[stored] = statistics.median(stage.times_s[-WINDOW:])
                ratios[stored].append(medians[stored] / statistics.median(waits))
                bare_s += waits
            growths.append(medians[max(medians)] / medians[min(medians)])
    wait_s = statistics.median(bare_s)
    rows = []
    for stored, stage in stages.items():
        p50_s, p99_s = np.quantile(stage.times_s, (0.5, 0.99))
        rows.append(
            [f"{stored}", f"{1e3 * p50_s:.3f}", f"{statistics.median(ratios[stored]):.2f}", f"{p99_s / wait_s:.1f}"]
        )
        stage.close()
    figures = {
        "fdatasync_p50_ms": 1e3 * wait_s,
        "transition_p50_in_waits": max(statistics.median(each) for each in ratios.values()),
        "transition_p50_growth": statistics.median(growths),
    }
    return figures, rows


def _wait_once(fd: int) -> float:
    begin_s = time.perf_counter()
    os.write(fd, b"x" * 512)
    os.fdatasync(fd)
    return time.perf_counter() - begin_s
