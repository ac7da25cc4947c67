"""Many sessions without work in one workspace: what each process holds in memory, and what a session leaves on disk.

    python benchmarks/soak.py --sessions 20000

Agent, watchdog and worker run as in `orchestration.py`, with a target in memory; goals of 20 sessions follow each
other. Evidence is thinned by the running plane itself; its policy keeps the newest 200 whole. Memory is the resident
set, from /proc; its slope is that of a straight line through all samples after the first 2000 sessions. The disk is
read at the end, after a last clean-up: the length of all files of the workspace, and the blocks that they occupy.
"""

import os
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.orchestration import HERE, write_graph
from benchmarks.runner import finish, run
from phyagentos.assembly.agent_plane import MemoryUse
from phyagentos.assembly.paths import open_project
from phyagentos.bench.report import Ask
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock

GOAL, SETTLED = 20, 2000  # sessions
NAMES = {"watch": "watchdog", "--target": "worker"}
SLOPE_MAX_KB, DISK_MAX_KB = 0.5, 20.0  # of a session


def list_processes(root: int) -> dict[str, int]:
    """Name -> process id: this one is the agent, below it the plane."""
    parents = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parents[int(folder.name)] = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue
    found = {"agent": root}
    for pid, parent in sorted(parents.items()):
        if parent in found.values():
            words = Path(f"/proc/{pid}/cmdline").read_bytes().decode().split("\0")
            found |= {name: pid for word, name in NAMES.items() if word in words}
    return found


def read_rss_mb(pid: int) -> float:
    """Resident set of a process [MB]."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def measure_disk(root: Path) -> tuple[float, float]:
    """Bytes in all files, and in their blocks; what several names share counts once."""
    seen = {}
    for path in root.rglob("*"):
        status = path.lstat()
        seen[status.st_ino] = (status.st_size, 512 * status.st_blocks)
    sizes, blocks = zip(*seen.values(), strict=True)
    return float(sum(sizes)), float(sum(blocks))


def main(*, sessions: int = 20000) -> int:
    """Run, show, and tell whether memory is flat and a session small."""
    console = Console()
    samples: dict[str, list[tuple[int, float]]] = defaultdict(list)
    with tempfile.TemporaryDirectory(prefix="soak-", ignore_cleanup_errors=True) as scratch:
        workspace = open_project(Path(scratch), HERE / "library")
        rules = workspace.runtime_contract.read_text().replace("keep_days: 30", "keep_days: 0")
        workspace.runtime_contract.write_text(rules)
        write_graph(workspace.root / "layered.yaml", "layered", GOAL)
        with open_bench(workspace, SystemClock(), memory_use=MemoryUse.NONE) as agent:
            for number in range(1, sessions // GOAL + 1):
                report = agent.mission.run(workspace.root / "layered.yaml", seed=0, goal=f"soak-{number}")
                if report.verdict != "success":
                    sys.exit(f"{report.goal}: {report.verdict}, {report.reason}")
                if number % 10 == 0:
                    for name, pid in list_processes(os.getpid()).items():
                        samples[name].append((number * GOAL, read_rss_mb(pid)))
                if number % 100 == 0:
                    console.print(number * GOAL, {name: round(each[-1][1], 1) for name, each in samples.items()})
        thinned_in_run = sum('"thinned"' in path.read_text() for path in workspace.evidence.glob("*/manifest.json"))
        prune = [sys.executable, "-m", "phyagentos", "evidence", "prune", "--workspace", str(workspace.root)]
        subprocess.run(prune, check=True, stdout=subprocess.DEVNULL)
        length, blocks = measure_disk(workspace.root)
    figures = {"thinned_by_plane": float(thinned_in_run), "sessions": float(sessions)}
    figures |= {"disk_kb_session": length / sessions / 1e3, "blocks_kb_session": blocks / sessions / 1e3}
    table = Table("process", "MB after 2000", "MB at the end", "kB a session", title=f"{sessions} sessions")
    for name, each in samples.items():
        late = np.array([sample for sample in each if sample[0] >= SETTLED])
        slope_kb = 1e3 * float(np.polyfit(late[:, 0], late[:, 1], 1)[0])
        table.add_row(name, f"{late[0, 1]:.1f}", f"{late[-1, 1]:.1f}", f"{slope_kb:.2f}")
        figures[f"{name}_kb_session"] = slope_kb
    console.print(table)
    asked = {f"{name}_kb_session": Ask(SLOPE_MAX_KB, at_least=False) for name in samples}
    asked |= {"disk_kb_session": Ask(DISK_MAX_KB, at_least=False), "thinned_by_plane": Ask(1.0, at_least=True)}
    return finish(figures, asked)


if __name__ == "__main__":
    try:
        run(main)
    except SystemExit as ended:
        sys.stdout.flush()
        os._exit(int(ended.code or 0))  # whatever threads are left
