#!/usr/bin/env python
"""Keeps what a benchmark measured, as benchmarks/records/NAME.json, from which docs/measured.md is written.

    python tools/record.py requests -- python benchmarks/requests.py
    python benchmarks/requests.py | python tools/record.py requests --command "python benchmarks/requests.py"
    python tools/record.py tidy_table --suite runs/tabletop-1 --command "paos bench run tabletop --seeds 20"

The figures are those of the last JSON line of the output that holds `figures`, or of the report of a suite. A first
record needs `--what` (one line) and `--says` (a sentence with `{figure}` in it); later ones keep those. `--without`
leaves figures out, such as times of a busy machine. Exits with the status of the command.
"""

import argparse
import json
import os
import platform
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

from phyagentos.clock import SystemClock

ROOT = Path(__file__).resolve().parents[1]
RECORDS = ROOT / "benchmarks" / "records"


def find_figures(lines: list[str]) -> dict[str, float]:
    """Of the last line that is JSON and has them; raises ValueError where there is none."""
    for line in reversed(lines):
        if line.startswith("{") and '"figures"' in line:
            figures: dict[str, float] = json.loads(line)["figures"]
            return figures
    raise ValueError("no line of the output is JSON with figures")


def read_suite(report: Path) -> dict[str, float]:
    """Counts of each task and setting of a suite, from its report.json."""
    figures: dict[str, float] = {}
    for row in json.loads(report.read_text(encoding="utf-8"))["rows"]:
        name = "_".join(filter(None, (row["task"], *row["axes"].values())))
        figures |= {f"{name}_goals": row["final"]["trials"], f"{name}_met": row["final"]["successes"]}
        figures |= {f"{name}_parts": row["parts"]["trials"], f"{name}_parts_first": row["first_parts"]["successes"]}
        figures |= {f"{name}_{key}": len(row[key]) for key in ("false_successes", "false_failures")}
    return figures


def make_record(name: str, command: str, figures: dict[str, float], what: str, says: str) -> dict[str, Any]:
    """The record of a measurement that was made just now, here; raises KeyError where `says` names no figure of it."""
    says.format(**figures)
    return {
        "name": name,
        "what": what,
        "says": says,
        "command": command,
        "commit": find_commit(),
        "date": SystemClock().wall_iso().partition("T")[0],
        "machine": f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}",
        "figures": figures,
    }


def find_commit() -> str:
    """Of the code: with a `+` where the package differs from it."""

    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()

    changed = git("status", "--porcelain", "--untracked-files=no", "phyagentos", "benchmarks/*.py")
    return git("rev-parse", "--short=12", "HEAD") + ("+" if changed else "")


def _measure(command: list[str]) -> tuple[int, dict[str, float]]:
    """Status and figures of a command, or of standard input where there is none; the output goes on to the terminal."""
    child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) if command else None
    lines = []
    for line in child.stdout if child is not None and child.stdout is not None else sys.stdin:
        print(line, end="", flush=True)
        lines.append(line)
    return child.wait() if child is not None else 0, find_figures(lines)


def read_arguments(words: list[str] | None = None) -> argparse.Namespace:
    """What is asked; options may stand before and after the name, and behind `--` stands the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name")
    parser.add_argument("--what", default="")
    parser.add_argument("--says", default="")
    parser.add_argument("--command", default="", help="what printed standard input, where no command is given")
    parser.add_argument("--suite", type=Path, help="folder of a run of `paos bench`, in place of an output")
    parser.add_argument("--without", default="", help="names of figures, with commas between them")
    parser.add_argument("run", nargs="*", metavar="-- COMMAND")
    return parser.parse_intermixed_args(words)


def main() -> int:
    """Measure, or read what was measured, and keep it."""
    given = read_arguments()
    path = RECORDS / f"{given.name}.json"
    before = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    what, says = given.what or before.get("what", ""), given.says or before.get("says", "")
    command = shlex.join(given.run) or given.command
    if not (what and says and command):
        sys.exit("a first record needs --what and --says, and every record a command")
    status, found = (0, read_suite(given.suite / "report.json")) if given.suite else _measure(given.run)
    figures = {name: each for name, each in found.items() if name not in given.without.split(",")}
    record = make_record(given.name, command, figures, what, says)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    return status


if __name__ == "__main__":
    sys.exit(main())
