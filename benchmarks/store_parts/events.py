"""From a record in one process to a durable claim in another: woken by the file system, beside a poll every second."""

import json
import statistics
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.journal import Journal
from phyagentos.store.watch import Watch

from .sessions import CLOCK, LANE, claim, open_pair, submit

POLL_S = 1.0


def measure_events(root: Path, sessions: int, polled: int, idle_s: float) -> dict[str, float]:
    """Latencies in milliseconds, and the share of a core that waiting takes."""
    woken = _measure(root / "woken", sessions, "woken", idle_s)
    slow = _measure(root / "polled", polled, "polled", 0.0)
    return {
        "event_p50_ms": float(np.quantile(woken["latencies_ms"], 0.5)),
        "event_p99_ms": float(np.quantile(woken["latencies_ms"], 0.99)),
        "idle_cpu_percent": 100 * woken["idle_cpu_s"] / idle_s,
        "poll_1s_p50_ms": statistics.median(slow["latencies_ms"]),
    }


def _measure(root: Path, sessions: int, how: str, idle_s: float) -> dict[str, float]:
    agent, runtime = open_pair(root, durable=True)
    runtime.close()
    code = "import sys; sys.path.insert(0, sys.argv[1]); from store_parts.events import run_claimer; run_claimer()"
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(Path(__file__).parents[1]), str(root), how, str(sessions), str(idle_s)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    begun_s = []
    for number in range(sessions):
        CLOCK.sleep(0.01 + 0.007 * (number % 3) if how == "woken" else 0.37)
        begun_s.append(time.perf_counter())
        agent.commit([submit(f"s{number}")])
        process.stdout.readline()
    told = json.loads(process.communicate()[0])
    agent.close()
    told["latencies_ms"] = [1e3 * (end - begin) for begin, end in zip(begun_s, told.pop("ended_s"), strict=True)]
    found: dict[str, float] = told
    return found


def run_claimer() -> None:
    """Waits, claims what was submitted, tells when that was durable; then waits for nothing."""
    root, how, sessions, idle_s = Path(sys.argv[2]), sys.argv[3], int(sys.argv[4]), float(sys.argv[5])
    journal = Journal(root, side=Side.RUNTIME, by="claimer", clock=CLOCK, partition=LANE)
    ended_s: list[float] = []
    with Watch([journal.folder]) as watch:
        journal.read_new()
        print("ready", flush=True)
        while len(ended_s) < sessions:
            if how == "woken":
                watch.wait(POLL_S)
            else:
                CLOCK.sleep(POLL_S)
            for record in journal.read_new():
                if record.ev == "submit":
                    journal.commit([claim(record.id)])
                    ended_s.append(time.perf_counter())
                    print("claimed", flush=True)
        journal.read_new()
        while watch.drain():
            pass
        cpu_s, end_s = time.process_time(), time.perf_counter() + idle_s
        while (left_s := end_s - time.perf_counter()) > 0:
            watch.wait(left_s)
            journal.read_new()
        cpu_s = time.process_time() - cpu_s
    journal.close()
    print(json.dumps({"ended_s": ended_s, "idle_cpu_s": cpu_s}))
