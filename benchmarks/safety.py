"""The safety layers under attack, and how long an emergency stop takes.

    python benchmarks/safety.py                  # 100 000 hostile commands, 1000 stops: some ten minutes
    python benchmarks/safety.py --quick          # small numbers, for a look; only the counts mean anything

One world process at a time, over its own wire. What is counted as outside was seen by an eye inside the physics process
that shares no code with what limits (`safety_parts/observed_world.py`). The stops are made in real time, one world
alone: several would compete for the processor and measure that.
"""

import tempfile
from pathlib import Path
from typing import Annotated, Literal

from typer import Option

from benchmarks.recorded import Robot, open_robot, record_tidy_table
from benchmarks.runner import finish, run, show, show_figures
from benchmarks.safety_parts.campaign import attack
from benchmarks.safety_parts.stops import measure_stops
from phyagentos.bench.report import Threshold

ASKED_OF_ATTACK = {
    "rows_outside_position": Threshold(0.0, at_least=False),
    "rows_outside_velocity": Threshold(0.0, at_least=False),
    "rows_outside_torque": Threshold(0.0, at_least=False),
    "rows_outside_workspace": Threshold(0.0, at_least=False),
    "hostile_passed": Threshold(0.0, at_least=False),
    "legitimate_refused": Threshold(0.0, at_least=False),
}
ASKED_OF_STOPS = {
    "silence_p99_periods": Threshold(2.0, at_least=False),
    "commands_after_asked": Threshold(0.0, at_least=False),
    "stops_still_moving": Threshold(0.0, at_least=False),
}


def run_attack(robot: Robot, commands: int, seeds: range) -> dict[str, float]:
    """Figures of the campaign."""
    recordings = record_tidy_table(robot, seeds)
    with tempfile.TemporaryDirectory() as folder:
        tally, seen = attack(Path(folder), robot, seeds, recordings, commands)
    outside = seen.count_outside(robot.profile, robot.folder)
    counters = {
        "way in": tally.sent,
        "kind": tally.kinds,
        "refused by": tally.codes,
        "within the limits, carried out": tally.accepted,
        "PASSED": tally.passed,
    }
    rows = ((f"{title}: {name}", count) for title, each in counters.items() for name, count in sorted(each.items()))
    show("Hostile commands", ("what", "count"), rows)
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


def main(
    *,
    commands: Annotated[int, Option(help="Hostile ones.")] = 100000,
    trials: Annotated[int, Option(help="Emergency stops.")] = 1000,
    seeds: Annotated[int, Option(help="Runs of tidy_table that go on meanwhile.")] = 10,
    only: Annotated[Literal["attack", "stops"] | None, Option(help="One half.")] = None,
    quick: Annotated[bool, Option(help="600 commands, 6 stops, one run.")] = False,
) -> int:
    """Print the tables and the closing line."""
    commands, trials, seeds = (600, 6, 1) if quick else (commands, trials, seeds)
    robot = open_robot()
    figures: dict[str, float] = {}
    asked: dict[str, Threshold] = {}
    if only != "stops":
        figures |= run_attack(robot, commands, range(1, seeds + 1))
        asked |= ASKED_OF_ATTACK | {"hostile": Threshold(float(commands), at_least=True)}
    if only != "attack":
        with tempfile.TemporaryDirectory() as folder:
            figures |= measure_stops(Path(folder), robot.profile, trials)
        asked |= ASKED_OF_STOPS | {"stops": Threshold(float(trials), at_least=True)}
    show_figures("Safety: one control period is 20 ms", figures, asked)
    return finish(figures, asked)


if __name__ == "__main__":
    run(main)
