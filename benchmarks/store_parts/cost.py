"""CPU and waits for the disk of one session, without and with the folds of both planes."""

import gc
import statistics
import time
from pathlib import Path

from phyagentos.store.segments import SystemIO

from .sessions import open_pair, prepare_life

REPEATS = 7


class CountingIO(SystemIO):
    """Counts the waits for the disk."""

    def __init__(self) -> None:
        self.waits = 0

    def fdatasync(self, fd: int) -> None:
        """Counted."""
        self.waits += 1
        super().fdatasync(fd)

    def fsync(self, fd: int) -> None:
        """Counted."""
        self.waits += 1
        super().fsync(fd)


def measure_cpu(root: Path, sessions: int) -> dict[str, float]:
    """Milliseconds of CPU per session of both writers; the least of several windows, for others share this machine."""
    return {
        "cpu_ms_per_session": _measure(root / "plain", sessions, folds=False),
        "cpu_ms_per_session_with_both_folds": _measure(root / "folds", sessions, folds=True),
    }


def _measure(root: Path, sessions: int, *, folds: bool) -> float:
    agent, runtime = open_pair(root, durable=False)
    ledgers = [(journal, journal.open_ledger()) for journal in (agent, runtime) if folds]
    windows = []
    gc.collect()
    gc.freeze()  # what this program has imported is none of the store's garbage
    for window in range(REPEATS):
        lives = [prepare_life(agent, runtime, f"s{window}.{number}") for number in range(sessions // REPEATS)]
        begin_s = time.process_time()
        for life in lives:
            for journal, entries, durable in life:
                journal.commit(entries, durable=durable)
            for journal, ledger in ledgers:
                for record in journal.read_new():
                    ledger.apply(record)
        windows.append((time.process_time() - begin_s) * 1e3 / (sessions // REPEATS))
    agent.close()
    runtime.close()
    return min(windows)


def count_waits(root: Path, sessions: int) -> dict[str, float]:
    """Waits for the disk per serial session."""
    counter = CountingIO()
    agent, runtime = open_pair(root, durable=True, file_io=counter)
    per_session = []
    for number in range(sessions):
        before = counter.waits
        for journal, entries, durable in prepare_life(agent, runtime, f"s{number}"):
            journal.commit(entries, durable=durable)
        per_session.append(counter.waits - before)
    agent.close()
    runtime.close()
    return {"waits_per_session": statistics.fmean(per_session)}
