"""What a death in the middle costs: a chain of sessions whose processes are killed by -9, beside other systems.

    python benchmarks/orchestration_recovery.py --peers-python <environment with the extra `peers`>/bin/python

Each system carries out a chain of tasks. When half of them have begun, every process of it is killed; then the same
command goes on. Counted are the tasks that were carried out more than once and those that never were. Ours are sessions
with preflight, evidence and verdict; what a session was about when it was killed is judged by what its evidence shows,
else a child session does it again. Tasks of the others write a line to a file: LangGraph, DBOS and Luigi repeat one
whose checkpoint was not written, Prefect begins its flow anew and finds kept results. Times are from the second start
to the end, with the start of processes; they compare how fast a system is back, not how fast it is.
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typer import Option

from benchmarks.orchestration import write_graph
from benchmarks.runner import finish, one_of, run, show
from phyagentos.bench.report import Spread, Threshold
from phyagentos.clock import SystemClock

HERE = Path(__file__).resolve().parent
PEERS = ("dbos", "langgraph", "luigi", "prefect", "temporal")
GOAL, LIMIT_S, LOOK_S = "chain", 300.0, 0.001


@dataclass(frozen=True, slots=True)
class Recovery:
    """One chain with a death in it: how often each task was carried out, and the time from the second start [s]."""

    counts: dict[int, int]
    ended: bool
    seconds: float

    def count_repeated(self) -> int:
        """Executions after the first one of a task."""
        return sum(count - 1 for count in self.counts.values())


def carry_on(command: list[str], folder: Path, n: int, count: Callable[[], dict[int, int]]) -> Recovery:
    """Start, kill the whole group when half of the tasks have begun, start again; `count` says what began how often."""
    clock = SystemClock()
    environment = {**os.environ, "DO_NOT_TRACK": "1", "PYTHONPATH": str(HERE.parent)}
    with (folder / "printed").open("ab") as printed:
        for is_second in (False, True):
            began_s = clock.now_s()
            process = subprocess.Popen(
                command, cwd=folder, env=environment, stdout=printed, stderr=printed, start_new_session=True
            )
            while process.poll() is None and clock.now_s() - began_s < LIMIT_S:
                if not is_second and len(count()) >= n // 2:
                    break
                clock.sleep(LOOK_S)
            seconds, code = clock.now_s() - began_s, process.poll()
            kill_all(process.pid)
            process.wait()
    return Recovery(count(), code == 0, seconds)


def kill_all(leader: int) -> None:
    """End every process below the one that was started, those of groups of their own too, at once."""
    parents = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            parents[int(stat.parent.name)] = int(stat.read_text().rpartition(")")[2].split()[1])
        except (OSError, ValueError):
            continue  # it has ended in between
    found, size = {leader}, 0
    while len(found) > size:
        size = len(found)
        found |= {child for child, parent in parents.items() if parent in found}
    for pid in found:
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue


def carry_on_ours(folder: Path, n: int) -> Recovery:
    """`paos run` of a chain, in a copy of the benchmark's library; a session is one command to a mark."""
    library, workspace = folder / "library", folder / "workspace"
    shutil.copytree(HERE / "library", library)
    write_graph(library / "goal_graphs" / f"{GOAL}.yaml", "chain", n, least_m=0.0)  # the mark dies with its process
    arguments = ["run", f"goal_graphs/{GOAL}.yaml", "--workspace", str(workspace), "--memory", "none", "--trust-python"]
    command = [sys.executable, "-m", "phyagentos", *arguments, "--no-pictures"]

    def count() -> dict[int, int]:
        bundles = (workspace / "evidence").glob(f"{GOAL}-0.n*")  # a child has a part more in its name
        return Counter(int(each.name.split(".")[1].lstrip("n")) for each in bundles)

    return carry_on(command, library, n, count)


def carry_on_peer(name: str, python: str, folder: Path, n: int) -> Recovery:
    """A peer's own way to go on; its tasks note themselves."""
    log = folder / "log"
    (folder / "scratch").mkdir()
    script = HERE / "orchestration_peers" / f"run_{name}.py"

    def count() -> dict[int, int]:
        lines = log.read_text().split("\n")[:-1] if log.exists() else []
        return Counter(map(int, lines))

    command = [str(Path(python).absolute()), str(script), "recover", str(n), str(log), str(folder / "scratch")]
    return carry_on(command, folder, n, count)


def main(
    *,
    sessions: int = 200,
    repeats: int = 3,
    peers: Annotated[list[str], Option(callback=one_of(*PEERS))] = PEERS,
    peers_python: Annotated[str, Option(help="interpreter that has the peers")] = sys.executable,
) -> int:
    """Run, show, and exit with whether nothing of ours was lost and at most what ran was repeated."""
    found: dict[str, list[Recovery]] = {}
    for name in ("phyagentos", *peers):
        for _ in range(repeats):
            with tempfile.TemporaryDirectory(prefix="recovery-", ignore_cleanup_errors=True) as scratch:
                folder = Path(scratch)
                is_ours = name == "phyagentos"
                one = (
                    carry_on_ours(folder, sessions) if is_ours else carry_on_peer(name, peers_python, folder, sessions)
                )
                found.setdefault(name, []).append(one)
    figures, rows = {}, []
    for name, each in found.items():
        figures |= {
            f"{name}_lost": float(max(sessions - len(one.counts) for one in each)),
            f"{name}_repeated": float(max(one.count_repeated() for one in each)),
            f"{name}_seconds_to_the_end": Spread.of([one.seconds for one in each]).median,
        }
        ended = f"{sum(one.ended for one in each)} of {repeats}"
        rows.append(
            (
                name,
                ended,
                *(f"{figures[f'{name}_{what}']:.3g}" for what in ("lost", "repeated")),
                f"{figures[f'{name}_seconds_to_the_end']:.1f} s",
            )
        )
    show(f"{sessions} tasks, killed in the middle", ("system", "ended", "lost", "repeated", "to the end"), rows)
    figures["phyagentos_ended"] = sum(one.ended for one in found["phyagentos"]) / repeats
    asked = {"phyagentos_lost": 0.0, "phyagentos_repeated": 1.0}
    limits = {name: Threshold(value, at_least=False) for name, value in asked.items()}
    return finish(figures, limits | {"phyagentos_ended": Threshold(1.0, at_least=True)})


if __name__ == "__main__":
    run(main)
