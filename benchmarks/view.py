"""What the page costs: a refresh for a goal of a thousand nodes, and eight viewers beside a run.

    python benchmarks/view.py --pairs 8   # needs the extra `view`

A refresh reads what is new and renders every panel, after a record that changes the goal; each of its 300 executed
nodes has a session, and the evidence of the one that is shown is that of a real run. A run is a whole `paos run` on
physics, alone and with a server whose eight streams one client reads, in turns; its CPU time is that of its processes.
Server and client give way (nice 10), as `paos view` does by itself.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median

from rich.console import Console

from benchmarks.runner import finish, run, show
from benchmarks.view_parts.thousand import measure_refreshes
from phyagentos.bench.report import Threshold
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace

ROOT = Path(__file__).resolve().parents[1]
GRAPH, VIEWERS, REFRESHES = "goal_graphs/tidy_table.yaml", 8, 40
ASKED = {
    "page_ms_median": Threshold(200, at_least=False),
    "page_ms_worst": Threshold(200, at_least=False),
    "run_wall_ratio": Threshold(1.03, at_least=False),
    "run_cpu_ratio": Threshold(1.03, at_least=False),
}


@contextmanager
def watched(root: Path, spent_s: list[float]) -> Iterator[subprocess.Popen[str]]:
    """A server of the page, and a client that reads as many streams of it as there are viewers.

    What CPU time the server spent while they read is added to `spent_s`.
    """
    command = [sys.executable, "-m", "phyagentos", "view", str(root), "--no-browser"]
    server = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert server.stdout is not None
    address = server.stdout.readline().strip()
    reader = [sys.executable, str(Path(__file__).parent / "view_parts" / "viewers.py"), address, str(VIEWERS)]
    client = subprocess.Popen(["nice", "-n", "10", *reader], stdout=subprocess.PIPE, text=True)
    assert client.stdout is not None
    assert client.stdout.readline().strip() == "reading"
    begun_s = _read_cpu_s(server.pid)
    try:
        yield client
    finally:
        spent_s.append(_read_cpu_s(server.pid) - begun_s)
        server.terminate()  # ends the streams, and so the client, which says what it has read
        server.wait()


def _read_cpu_s(pid: int) -> float:
    """CPU time of a process so far [s]; proc(5), fields 14 and 15."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def time_run(root: Path) -> tuple[float, float]:
    """Wall and CPU time of one run with all its processes [s]."""
    command = [sys.executable, "-m", "phyagentos", "run", GRAPH, "--seed", "7", "--memory", "none", "--no-pictures"]
    begun_s = time.perf_counter()
    process = subprocess.Popen(
        [*command, "-q", "-w", str(root)], cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise SystemExit(f"the goal was not met: {process.returncode}, see {root}")
    return time.perf_counter() - begun_s, used.ru_utime + used.ru_stime


def time_pairs(scratch: Path, pairs: int) -> tuple[list[dict[str, tuple[float, float]]], list[int], list[float], Path]:
    """Runs alone and watched, in turns; bytes that each client read; CPU time of each server; the last workspace."""
    found, read, spent_s = [], [], []
    for pair in range(pairs + 1):
        times: dict[str, tuple[float, float]] = {}
        for kind in ("alone", "watched") if pair % 2 else ("watched", "alone"):
            root = scratch / f"{pair}_{kind}"
            Workspace.create(root, Library.open(ROOT))
            if kind == "alone":
                times[kind] = time_run(root)
            else:
                with watched(root, spent_s) as client:
                    times[kind] = time_run(root)
                read.append(int(client.communicate()[0]))
        if pair:  # the first pair warms caches
            found.append(times)
            Console(stderr=True).print(f"pair {pair}: {times}", style="dim")
    return found, read[1:], spent_s[1:], root


def main(*, pairs: int = 8) -> int:
    """Measure, show, and exit with whether every asked figure holds."""
    with tempfile.TemporaryDirectory(prefix="view-") as folder:
        timed, read, server_s, root = time_pairs(Path(folder), pairs)
        spent_ms = measure_refreshes(Path(folder) / "thousand", root, REFRESHES)
    show(
        f"a refresh of a goal of a thousand nodes [ms], {REFRESHES} times",
        ("", "median", "worst", "CPU, median"),
        (
            (name, f"{median(each.wall_ms):.1f}", f"{max(each.wall_ms):.1f}", f"{median(each.cpu_ms):.1f}")
            for name, each in spent_ms.items()
        ),
    )
    ratios, rows = {}, []
    for index, name in enumerate(("wall", "cpu")):
        alone, beside = ([pair[kind][index] for pair in timed] for kind in ("alone", "watched"))
        ratios[name] = median(b / a for a, b in zip(alone, beside, strict=True))
        rows.append((name, f"{median(alone):.2f}", f"{median(beside):.2f}", f"{ratios[name]:.4f}"))
    title = f"a run alone and with {VIEWERS} viewers, {pairs} pairs in turns [s]"
    show(title, ("", "alone", "watched", "ratio of a pair, median"), rows)
    figures = {
        "first_ms": spent_ms["first"].wall_ms[0],
        "page_ms_median": median(spent_ms["page"].wall_ms),
        "page_ms_worst": max(spent_ms["page"].wall_ms),
        "page_cpu_ms_median": median(spent_ms["page"].cpu_ms),
        "run_wall_ratio": ratios["wall"],
        "run_cpu_ratio": ratios["cpu"],
        "viewers": float(VIEWERS),
        "server_cpu_s": median(server_s),
        "bytes_a_viewer": median(read) / VIEWERS,
        "pairs": float(pairs),
    }
    return finish(figures, ASKED)


if __name__ == "__main__":
    run(main)
