"""Sessions without work through the finished path, beside other systems that run graphs of tasks durably.

    python benchmarks/orchestration.py --peers-python <environment with the extra `peers`>/bin/python

Ours: a goal graph in YAML is compiled, each session is submitted, checked by preflight, claimed, run by one warm worker
(one command to a target in memory), leaves its evidence bundle, and is judged on that evidence; journal durable, views
rendered; agent and runtime in processes of their own. Peers run tasks that do nothing at all. Times are from the graph
to the last verdict, without starting processes. `--quick` is a smoke test: few sessions, no peers.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from rich.console import Console
from rich.table import Table
from typer import Option

from benchmarks.orchestration_shapes import build_edges
from benchmarks.runner import finish, one_of, run
from phyagentos.assembly.agent_plane import MemoryUse
from phyagentos.assembly.paths import open_project
from phyagentos.assembly.process_tuning import collect_rarely
from phyagentos.bench.report import Spread, Threshold
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock

HERE = Path(__file__).resolve().parent
SHAPES = ("layered", "chain")
STEP_M = 0.02  # by which one session moves the mark
# how many times their rate is asked; of DBOS and LangGraph 65 % of what checks ahead of their turn had reached
PEERS = {"prefect": 10.0, "dagster": 10.0, "luigi": 5.0, "dbos": 0.46, "langgraph": 0.73, "temporal": 1.0}
COMPARED = {"langgraph": ("chain",)}  # elsewhere both shapes; its layered form waits for the disk once a layer
SLOW = frozenset({"prefect", "dagster"})  # run once; the others as often as we
PEER_LIMIT_S = 900.0
CONSTANT_SIZES = (100, 10_000)


@dataclass(slots=True)
class Result:
    """One system: seconds of each run by shape, and what it says of itself."""

    name: str
    seconds: dict[str, list[float]]
    durable: str = ""
    workers: str = ""
    version: str = ""

    def compute_rate(self, shape: str, n: int) -> float:
        """Sessions per second, the median run; NaN without one."""
        return n / Spread.of(self.seconds[shape]).median


def write_graph(path: Path, shape: str, n: int, *, least_m: float | None = None) -> None:
    """A goal graph of this shape; the goal is met when the mark has risen to `least_m`, else by a step a session."""
    lines = [
        f"goal: {shape}",
        "objective: Nothing but steps.",
        "scene: counter",
        "targets: {slide: counter}",
        "sessions:",
    ]
    for index, before in enumerate(build_edges(shape, n)):
        after = ", ".join(f"n{each}" for each in before)
        lines.append(f"  n{index}: {{skill: advance, target: slide, after: [{after}]}}")
    least_m = STEP_M * (n - 0.6) if least_m is None else least_m
    lines.append(f'accept: ["height(mark) >= {least_m:.4f}"]')
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def time_ours(root: Path, runs: list[tuple[str, int]]) -> list[float]:
    """Seconds of each run, on one warm plane.

    Raises:
        SystemExit: When a session did not succeed, or left no evidence.
    """
    seconds = []
    workspace = open_project(root, HERE / "library")
    with open_bench(workspace, SystemClock(), memory_use=MemoryUse.NONE) as agent:  # sessions are counted, not lessons
        write_graph(root / "warm_up.yaml", "chain", 3)
        agent.mission.run(root / "warm_up.yaml", seed=0, goal="warm_up")
        for number, (shape, n) in enumerate(runs):
            goal, file = f"{shape}-{number}", root / f"{shape}.yaml"
            write_graph(file, shape, n)
            begin_s = time.perf_counter()
            report = agent.mission.run(file, seed=0, goal=goal)
            seconds.append(time.perf_counter() - begin_s)
            succeeded = sum(session.verdict == "success" for session in report.sessions)
            bundles = sum(
                (workspace.evidence_of(session.id) / "execution.json").exists() for session in report.sessions
            )
            if (report.verdict, succeeded, bundles) != ("success", n, n):
                sys.exit(f"{goal}: {report.verdict}, {succeeded} succeeded, {bundles} bundles, {report.reason}")
    return seconds


def time_peer(name: str, python: str, shape: str, n: int, result: Result, console: Console) -> None:
    """One run of a peer in a process of its own; it stays without figures when it is not installed there."""
    command = [python, str(HERE / "orchestration_peers" / f"run_{name}.py"), shape, str(n)]
    environment = {**os.environ, "DO_NOT_TRACK": "1"}
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=PEER_LIMIT_S, env=environment, check=False
        )
    except subprocess.TimeoutExpired:
        console.print(f"{name}, {shape}: not finished within {PEER_LIMIT_S:.0f} s")
        return
    told = [line for line in done.stdout.splitlines() if line.startswith('{"seconds"')]
    if told:
        figures = json.loads(told[-1])
        result.seconds[shape].append(figures["seconds"])
        result.durable, result.workers, result.version = figures["durable"], figures["workers"], figures["version"]
        console.print(f"{name}, {shape}: {n / figures['seconds']:.0f}/s")
    elif "ModuleNotFoundError" in done.stderr:
        result.durable = "not installed"
    else:
        console.print(f"{name}, {shape}: ended with code {done.returncode}: {done.stderr.strip()[-300:]}")


def measure_sync_ms(folder: Path) -> float:
    """Median of a small append that waits for the disk [ms]: what this disk asks of everybody."""
    seconds = []
    with (folder / "sync").open("ab", buffering=0) as file:
        for _ in range(100):
            file.write(b"x" * 512)
            begin_s = time.perf_counter()
            os.fdatasync(file.fileno())
            seconds.append(time.perf_counter() - begin_s)
    return 1e3 * Spread.of(seconds).median


def show_rates(results: list[Result], n: int, sync_ms: float, console: Console) -> None:
    """The table."""
    table = Table(
        "system",
        "layered/s",
        "chain/s",
        "layered ms",
        "chain ms",
        "durable",
        "workers",
        title=f"{n} tasks without work; an append that waits for the disk takes {sync_ms:.2f} ms",
    )
    for result in results:
        rates = [result.compute_rate(shape, n) if result.seconds[shape] else None for shape in SHAPES]
        cells = [f"{rate:.0f}" if rate else "-" for rate in rates] + [
            f"{1e3 / rate:.2f}" if rate else "-" for rate in rates
        ]
        table.add_row(f"{result.name} {result.version}".strip(), *cells, result.durable, result.workers)
    console.print(table)


def compare(ours: Result, peers: list[Result], n: int) -> tuple[dict[str, float], dict[str, Threshold]]:
    """Our rate over each peer's, the smaller one of the shapes that are compared."""
    figures: dict[str, float] = {}
    asked: dict[str, Threshold] = {}
    for peer in peers:
        shapes = COMPARED.get(peer.name, SHAPES)
        if all(peer.seconds[shape] for shape in shapes):
            name = f"times_{peer.name}"
            figures[name] = min(ours.compute_rate(shape, n) / peer.compute_rate(shape, n) for shape in shapes)
            asked[name] = Threshold(PEERS[peer.name], at_least=True)
    return figures, asked


def main(
    *,
    sessions: int = 1000,
    repeats: int = 3,
    peers: Annotated[list[str], Option(callback=one_of(*PEERS))] = tuple(PEERS),
    peers_python: Annotated[str, Option(help="interpreter that has the peers")] = sys.executable,
    no_constancy: Annotated[bool, Option(help="leave out the run of 10 000 sessions")] = False,
    scratch: Annotated[Path | None, Option(help="folder on the disk to measure; the system's own by default")] = None,
    quick: bool = False,
) -> int:
    """Run, show, and exit with whether every asked figure holds."""
    n, turns = (100, 1) if quick else (sessions, repeats)
    console = Console()
    collect_rarely()
    # one folder for all, removed at the end: ext4 skips inodes that were freed a moment ago, one by one
    with tempfile.TemporaryDirectory(prefix="orchestration-", dir=scratch) as name:
        folder = Path(name)
        ours = Result("phyagentos", {shape: [] for shape in SHAPES}, "journal, 1 fsync a session", "1")
        others = [Result(peer, {shape: [] for shape in SHAPES}) for peer in ([] if quick else peers)]
        os.environ["TMPDIR"] = name
        sync_ms = measure_sync_ms(folder)
        for turn in range(turns):
            runs = [(shape, n) for shape in SHAPES]
            for shape, seconds in zip(SHAPES, time_ours(folder / f"ours-{turn}", runs), strict=True):
                ours.seconds[shape].append(seconds)
                console.print(f"phyagentos, {shape}: {n / seconds:.0f}/s")
            for peer in others:
                if turn == 0 or peer.name not in SLOW:
                    for shape in SHAPES:
                        time_peer(peer.name, peers_python, shape, n, peer, console)
        figures, asked = compare(ours, others, n)
        if not quick and not no_constancy:
            small, large = CONSTANT_SIZES
            seconds = time_ours(folder / "constancy", [*[("layered", small)] * 5, ("layered", large)])
            figures["cost_ratio_10000_to_100"] = (seconds[-1] / large) / (Spread.of(seconds[:-1]).median / small)
            figures["ms_per_session_10000"] = 1e3 * seconds[-1] / large
            asked["cost_ratio_10000_to_100"] = Threshold(1.3, at_least=False)
    show_rates([ours, *others], n, sync_ms, console)
    figures |= {f"{shape}_per_s": ours.compute_rate(shape, n) for shape in SHAPES}
    return finish(figures | {"sessions": float(n), "sync_ms": sync_ms}, asked)


if __name__ == "__main__":
    run(main)
