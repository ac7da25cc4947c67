"""The safety layers under attack, and how long an emergency stop takes.

    python benchmarks/safety.py                  # 100 000 hostile commands, 1000 stops: some ten minutes
    python benchmarks/safety.py --quick          # small numbers, for a look; only the counts mean anything
    python benchmarks/safety.py --remote         # the world behind a WebSocket, commanded by the driver `remote`

One world process at a time, over its own wire. What is counted as outside was seen by an eye inside the physics process
that shares no code with what limits (`safety_parts/observed_world.py`). The stops are made in real time, one world
alone: several would compete for the processor and measure that.
"""

import argparse
import sys
import tempfile
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.outcome import format_outcome
from benchmarks.recorded import Robot, open_robot, record_tidy_table
from benchmarks.safety_parts.campaign import Tally, attack
from benchmarks.safety_parts.stops import measure_stops
from phyagentos.bench.report import Ask

ASKED_OF_ATTACK = {
    "rows_outside_position": Ask(0.0, at_least=False),
    "rows_outside_velocity": Ask(0.0, at_least=False),
    "rows_outside_torque": Ask(0.0, at_least=False),
    "rows_outside_workspace": Ask(0.0, at_least=False),
    "hostile_passed": Ask(0.0, at_least=False),
    "legitimate_refused": Ask(0.0, at_least=False),
}
ASKED_OF_STOPS = {
    "silence_p99_periods": Ask(2.0, at_least=False),
    "commands_after_asked": Ask(0.0, at_least=False),
    "stops_still_moving": Ask(0.0, at_least=False),
}


def run_attack(robot: Robot, commands: int, seeds: range, console: Console, *, is_remote: bool) -> dict[str, float]:
    """Figures of the campaign."""
    recordings = record_tidy_table(robot, seeds)
    with tempfile.TemporaryDirectory() as folder:
        tally, seen = attack(Path(folder), robot, seeds, recordings, commands, is_remote=is_remote)
    outside = seen.count_outside(robot.profile, robot.folder)
    console.print(_tabulate(tally))
    return {
        "hostile": float(tally.sent.total()),
        "hostile_by_handle": float(tally.sent["handle"] + tally.sent["driven, guarded"]),
        "hostile_by_wire": float(tally.sent["wire"] + tally.sent["driven, bare wire"]),
        "hostile_passed": float(tally.passed.total()),
        "driven": float(tally.sent["driven, guarded"] + tally.sent["driven, bare wire"]),
        "driven_accepted": float(tally.accepted.total()),
        "legitimate": float(tally.legitimate),
        "legitimate_refused": float(tally.legitimate_refused),
        "rows_seen": float(len(seen.q)),
        **{f"rows_outside_{name}": float(count) for name, count in outside.items()},
    }


def _tabulate(tally: Tally) -> Table:
    """What was sent and what became of it."""
    table = Table(title="Hostile commands")
    for name in ("what", "count"):
        table.add_column(name, justify="right" if name == "count" else "left")
    for title, counter in (
        ("way in", tally.sent),
        ("kind", tally.kinds),
        ("refused by", tally.codes),
        ("within the limits, carried out", tally.accepted),
        ("PASSED", tally.passed),
    ):
        for name, count in sorted(counter.items()):
            table.add_row(f"{title}: {name}", str(count))
        table.add_section()
    return table


def main() -> int:
    """Print the tables and the closing line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--commands", type=int, default=100_000, help="Hostile ones.")
    parser.add_argument("--trials", type=int, default=1000, help="Emergency stops.")
    parser.add_argument("--seeds", type=int, default=10, help="Runs of tidy_table that go on meanwhile.")
    parser.add_argument("--only", choices=("attack", "stops"), help="One half.")
    parser.add_argument("--remote", action="store_true", help="By the driver `remote`, over WebSocket.")
    parser.add_argument("--quick", action="store_true", help="600 commands, 6 stops, one run.")
    given = parser.parse_args()
    commands, trials, seeds = (600, 6, 1) if given.quick else (given.commands, given.trials, given.seeds)
    robot, console = open_robot(), Console()
    figures: dict[str, float] = {}
    asked: dict[str, Ask] = {}
    if given.only != "stops":
        figures |= run_attack(robot, commands, range(1, seeds + 1), console, is_remote=given.remote)
        asked |= ASKED_OF_ATTACK | {"hostile": Ask(float(commands), at_least=True)}
    if given.only != "attack":
        with tempfile.TemporaryDirectory() as folder:
            figures |= measure_stops(Path(folder), robot.profile, trials, is_remote=given.remote)
        asked |= ASKED_OF_STOPS | {"stops": Ask(float(trials), at_least=True)}
    table = Table(title="Safety: one control period is 20 ms")
    for name in ("figure", "found", "asked"):
        table.add_column(name, justify="left" if name == "figure" else "right")
    for name, value in figures.items():
        table.add_row(name, f"{value:.6g}", str(asked.get(name, "")))
    console.print(table)
    line, holds = format_outcome(figures, asked)
    print(line)
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
