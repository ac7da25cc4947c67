"""What each body of the fleet did, in how much time, and what it costs in lines: measured on runs of suites.

    paos bench run arms --run runs/arms-1; paos bench run bodies --run runs/bodies-1
    python benchmarks/fleet.py runs/arms-1 runs/bodies-1

Success is what the suite's scorer says of the recorded states. Planning is that of a session, guard counts the commands
that the guard changed, and lines are those of the body's own folder below `robots/`.
"""

import json
import statistics
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from rich.console import Console
from rich.table import Table
from typer import Argument

from benchmarks.runner import finish, run
from phyagentos.bench.records import EpisodeRecord, read_records
from phyagentos.bench.report import Ask, Rate
from phyagentos.protocol.capabilities.library import Library
from phyagentos.runtime.models.robot import read_profile

ENOUGH, ARMS = 0.95, 10  # share of its parts that a body has to do, and how many arms have to
COLUMNS = ("body", "model", "task", "parts", "goals", "planning, s", "guard", "stops", "YAML", "Python")


def list_bundles(run: Path, record: EpisodeRecord) -> list[Path]:
    """Bundles of the sessions of an episode that were executed."""
    folders = [run / session.bundle for session in record.sessions if session.bundle]
    return [folder for folder in folders if (folder / "execution.json").exists()]


def count_lines(body: str) -> dict[str, int]:
    """Lines of the body's own folder, by kind of file."""
    folder = Library.open().get_target(body).parent
    files = {kind: folder.rglob(f"*.{kind}") for kind in ("yaml", "py")}
    return {kind: sum(len(each.read_text().splitlines()) for each in found) for kind, found in files.items()}


def add_row(table: Table, body: str, records: Sequence[tuple[Path, EpisodeRecord]]) -> Rate:
    """One body in one task; the share of its parts that was done."""
    episodes = [record for _, record in records]
    bundles = [folder for run, record in records for folder in list_bundles(run, record)]
    planning_s = [session.stages_ms.get("planning", 0.0) / 1e3 for each in episodes for session in each.sessions]
    guard = sum(json.loads((each / "execution.json").read_text()).get("interventions", 0) for each in bundles)
    stops = sum("SAFETY_STOP" in str(session.cause) for each in episodes for session in each.sessions)
    parts = [done for each in episodes for done in each.parts.values()]
    goals = Rate(sum(bool(each.is_met) and each.verdict == "success" for each in episodes), len(episodes))
    path = Library.open().get_target(body)
    rate, lines = Rate(sum(parts), len(parts)), count_lines(body)
    planning = f"{statistics.median(planning_s):.2f}" if planning_s else "none"
    counts = map(str, (guard, stops, lines["yaml"], lines["py"]))
    table.add_row(
        body, read_profile(path)[0].model, episodes[0].goal.rsplit("-", 1)[0], str(rate), str(goals), planning, *counts
    )
    return rate


def main(runs: Annotated[list[Path], Argument(help="folders of runs of arms and bodies")]) -> int:
    """Show every body, and tell whether ten arms, and every other body, do 95 % of their task."""
    table = Table(*COLUMNS, title="the fleet")
    groups: dict[tuple[str, str], list[tuple[Path, EpisodeRecord]]] = defaultdict(list)
    false_successes, bodies = 0, {}
    for folder in runs:
        for record in read_records(folder):
            key = (record.task, record.setting)
            groups[key].append((folder, record))
            false_successes += record.is_false_success
            if record.sessions:
                bodies[key] = record.sessions[0].target
    figures = {"false_successes": float(false_successes), "arms_at_95_percent": 0.0, "others_below_95_percent": 0.0}
    for key, records in sorted(groups.items()):
        body = bodies.get(key, key[1])
        rate = add_row(table, body, records)
        figures[f"{body}: {key[0]}"] = rate.value
        figures["arms_at_95_percent"] += key[0] == "tidy_table" and rate.value >= ENOUGH
        figures["others_below_95_percent"] += key[0] != "tidy_table" and rate.value < ENOUGH
    Console(highlight=False, width=170).print(table)
    asked = {
        "arms_at_95_percent": Ask(ARMS, at_least=True),
        "others_below_95_percent": Ask(0, at_least=False),
        "false_successes": Ask(0, at_least=False),
    }
    return finish(figures, asked)


if __name__ == "__main__":
    run(main)
