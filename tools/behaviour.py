"""What every shipped goal graph does, as hashes: run it at two commits, in one environment, and compare.

    python tools/behaviour.py measure before.json --source ../before
    python tools/behaviour.py measure after.json
    python tools/behaviour.py compare before.json after.json

A row holds the verdict of the goal and, for each session, its state, its verdict, the truth and the numbers of each
criterion, and SHA-256 of the arrays of `trajectory.npz` and `terminal.npz`. Texts, codes and names are left out: they
may change where behaviour stays. Robots whose models are absent are named and left out (`MENAGERIE_ROOT`).
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
SEEDS = (1, 2, 3)
ARRAYS = ("trajectory.npz", "terminal.npz")
FAULTED = {  # fault -> the graph that it strikes
    "shove_g1": "stand_and_reach",
    "shove_r1": "stand_and_reach",
}
OVERRIDES = {"shove_r1": ["--set", "targets.body=r1"]}
FAULTED_BY_DEFAULT = "tidy_table"
NO_GRAPH = {"cameras_askew"}  # strikes only goals of a suite that are named after it
NOT_RUN = 2  # exit code of a run that was refused before anything started
# Read by the package of the source that is measured, over its public facade.
READ = """
import json, sys, phyagentos as paos
seen = paos.open_workspace(sys.argv[1])
def numbers(measured):
    return sorted(float(value) for value in measured.values() if type(value) in (int, float))
def judge(criteria):
    return [[str(each.truth), numbers(each.measured)] for each in criteria]
def of_goal(goal):
    return {"verdict": str(goal.verdict), "criteria": judge(goal.status.criteria)}
def of_session(each):
    kept = {"state": str(each.state), "verdict": str(each.verdict), "evidence": str(each.evidence)}
    return kept | {"criteria": judge(each.criteria)}
goals = {str(goal.id): of_goal(goal) for goal in seen.goals.values()}
print(json.dumps({"goals": goals, "sessions": {str(each.id): of_session(each) for each in seen}}))
"""


def iter_cases() -> Iterator[tuple[str, list[str]]]:
    """Name of a case, and the arguments of `paos run`."""
    graphs = sorted(file.stem for file in (ROOT / "goal_graphs").glob("*.yaml"))
    faults = sorted(file.stem for file in (ROOT / "faults").glob("*.yaml") if file.stem not in NO_GRAPH)
    for seed in SEEDS:
        for graph in graphs:
            yield f"{graph}-{seed}", [graph, "--seed", str(seed)]
        for fault in faults:
            graph = FAULTED.get(fault, FAULTED_BY_DEFAULT)
            yield f"{graph}+{fault}-{seed}", [graph, "--seed", str(seed), "--faults", fault, *OVERRIDES.get(fault, [])]


def measure_case(source: Path, arguments: list[str]) -> dict[str, Any]:
    """Run one case in a new folder; what it left, or why it was not run."""
    environment = os.environ | {"PYTHONPATH": str(source), "PHYAGENTOS_MEMORY": "none"}
    with tempfile.TemporaryDirectory(prefix="behaviour-") as folder:
        place = Path(folder) / "run"
        run = [
            sys.executable,
            "-m",
            "phyagentos",
            "run",
            *arguments,
            "--workspace",
            str(place),
            "--no-pictures",
            "--quiet",
        ]
        done = subprocess.run(run, cwd=folder, env=environment, capture_output=True, text=True, check=False)
        if done.returncode == NOT_RUN:
            return {"not_run": done.stderr.strip().splitlines()[:1]}
        read = [sys.executable, "-c", READ, str(place)]
        found = subprocess.run(read, cwd=folder, env=environment, capture_output=True, text=True, check=False)
        if found.returncode:
            return {"unreadable": (done.stderr + found.stderr).strip().splitlines()[-3:]}
        row: dict[str, Any] = {"exit_code": done.returncode} | json.loads(found.stdout)
        for session in row["sessions"].values():
            evidence = Path(session.pop("evidence"))
            session |= {name: hash_arrays(evidence / name) for name in ARRAYS}
        return row


def hash_arrays(file: Path) -> str:
    """Names, types, shapes and bytes of the arrays of one file; empty where it is absent."""
    if not file.exists():
        return ""
    digest = hashlib.sha256()
    with np.load(file) as arrays:
        for name in sorted(arrays.files):
            value = np.ascontiguousarray(arrays[name])
            digest.update(f"{name} {value.dtype} {value.shape} ".encode())
            digest.update(value.tobytes())
    return digest.hexdigest()


def measure(out: Path, source: Path, jobs: int, only: list[str]) -> int:
    """Write the row of each case to a file, which is kept up to date: a second call goes on."""
    rows: dict[str, Any] = json.loads(out.read_text()) if out.exists() else {}
    cases = [(name, words) for name, words in iter_cases() if name not in rows and (not only or name in only)]
    with ThreadPoolExecutor(jobs) as pool:
        for (name, _), row in zip(cases, pool.map(lambda case: measure_case(source, case[1]), cases), strict=True):
            rows[name] = row
            out.write_text(json.dumps(rows, indent=1, sort_keys=True))
            print(name, row.get("not_run") or row.get("unreadable") or f"exit code {row['exit_code']}", flush=True)
    return int(any("unreadable" in row for row in rows.values()))


def compare(before: Path, after: Path) -> int:
    """Print what differs and one line of JSON; 1 where something does, or a case is missing."""
    old, new = (json.loads(file.read_text()) for file in (before, after))
    common = sorted(old.keys() & new.keys())
    changed = [name for name in common if old[name] != new[name]]
    for name in changed:
        print(f"{name} differs")
    for name in sorted(old.keys() ^ new.keys()):
        print(f"{name} stands in one file only")
    ran = [name for name in common if "exit_code" in old[name]]
    figures = {
        "cases": len(ran),
        "sessions": sum(len(old[name]["sessions"]) for name in ran),
        "equal": sum(name not in changed for name in ran),
        "not_run": len(common) - len(ran),
        "missing": len(old.keys() ^ new.keys()),
    }
    asked = {"equal": figures["cases"], "missing": 0}
    holds = all(figures[name] == value for name, value in asked.items())
    print(json.dumps({"figures": figures, "asked": asked, "holds": holds}))
    return int(not holds)


def main() -> int:
    """Measure or compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    actions = parser.add_subparsers(dest="action", required=True)
    measuring = actions.add_parser("measure")
    measuring.add_argument("out", type=Path)
    measuring.add_argument("--source", type=Path, default=ROOT, help="Checkout whose package runs; this one without.")
    measuring.add_argument("--jobs", type=int, default=1, help="Runs at a time.")
    measuring.add_argument("--only", nargs="*", default=[], metavar="CASE", help="GRAPH-SEED or GRAPH+FAULT-SEED.")
    comparing = actions.add_parser("compare")
    comparing.add_argument("before", type=Path)
    comparing.add_argument("after", type=Path)
    options = parser.parse_args()
    if options.action == "compare":
        return compare(options.before, options.after)
    return measure(options.out.resolve(), options.source.resolve(), options.jobs, options.only)


if __name__ == "__main__":
    sys.exit(main())
