"""Worlds that nothing was made for: rooms, goals and faults drawn from seeds, judged by code of their own.

    python -m benchmarks.unseen --goals 300 --jobs 2 --results unseen.jsonl     # held-out seeds; run again to resume
    python -m benchmarks.unseen --development --goals 30 --results dev.jsonl
    python -m benchmarks.unseen --table slick --goals 50 --results slick.jsonl  # friction 0.1; `grippy`: 1.0

A seed is one goal of one to four nodes in one room of three to eight things and more. Seeds below 100 000 are for
development; the held-out ones begin at 1 000 000, and nothing is tuned on them. About a third of the goals carry a
fault or an impossible detail. About a quarter of the nodes only claim something, which is false half of the time.

The judge (`unseen_parts/judge.py`) reads `scene.mjb` and `terminal.npz` with numpy and MuJoCo alone;
`unseen_parts/feasible.py` decides by reach, opening, free volume and friction what can be met. Both import nothing of
the package. Where two honest judges may differ (1 mm, 1 degree, half the weight borne) a session is open: it counts
neither for nor against a verdict. An infeasible goal is refused before motion when no session of a node that cannot be
met moved the arm. Half of the goals with equal things say that these are interchangeable: the judge then accepts every
naming. The others cannot be decided by looks: their nodes are listed, and count for false successes alone. A node that
was never begun, behind one that cannot be met or claims what is false, is no missed first attempt; it is counted apart.

What scene, goal and fault files cannot say yet is missing here: meshes and curved hollow walls (bowls and mugs are
rings of flat walls), bodies outside of the inventory (flat coloured prints are seen and not reported), glassy or black
surfaces without depth, things that begin tilted (some come to lean on a slab), drawers, lids and doors of random
make, volumes hidden under covers, and predicates on metrics.

Each goal is one line of the results file, written when it ended: a run resumes where it stopped and counts no seed
twice.
"""

import argparse
import json
import sys
from pathlib import Path

from rich.console import Console

from benchmarks.unseen_parts.figures import ASKED, Tally
from benchmarks.unseen_parts.lane import FRICTION
from benchmarks.unseen_parts.lanes import run_lanes
from benchmarks.unseen_parts.records import GoalRecord, iter_findings
from phyagentos.bench.report import format_outcome

DEVELOPMENT, HELD_OUT = 0, 1_000_000  # first seeds
DEVELOPMENT_END = 100_000
WALL_S = 900.0  # a goal that takes longer hangs


def main() -> int:
    """Run what is missing, show everything, and exit with whether every asked figure holds."""
    given = parse_arguments()
    console = Console(stderr=True)
    first = DEVELOPMENT if given.development else HELD_OUT
    first = first if given.first is None else given.first
    seeds = given.seeds or list(range(first, first + given.goals))
    known = read_results(given.results, given.table)
    missing = [seed for seed in seeds if seed not in known]
    work = given.keep or given.results.with_suffix(".work")
    with given.results.open("a") as results:
        for record in run_lanes(
            missing, given.table, given.sense, work, given.jobs, given.wall_s, keeps=bool(given.keep)
        ):
            results.write(json.dumps(record.as_json()) + "\n")
            results.flush()
            known[record.seed] = record
            told = f"seed {record.seed}: {record.kind}, feasible {record.feasible}, {record.verdict or record.ended}"
            console.print(f"{len(known)}: {told}, truth {record.truth or '-'}, {record.wall_s:.0f} s", style="dim")
            for finding in iter_findings(record):
                console.print(finding, highlight=False, markup=False)
    tally = Tally(known[seed] for seed in seeds if seed in known)
    tally.show(Console(), f"unseen worlds, table {given.table}, seeds {min(seeds)} to {max(seeds)}")
    line, holds = format_outcome(tally.build_figures(), ASKED)
    print(line)
    return 0 if holds else 1


def parse_arguments() -> argparse.Namespace:
    """What is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--goals", type=int, default=300)
    parser.add_argument("--development", action="store_true", help="seeds for development instead of held-out ones")
    parser.add_argument("--first", type=int, help="first seed, else that of the range")
    parser.add_argument("--seeds", type=int, nargs="+", help="these seeds only")
    parser.add_argument("--table", choices=sorted(FRICTION), default="unseen", help="which friction")
    parser.add_argument("--results", type=Path, required=True, help="one JSON line a goal; what stands there is kept")
    parser.add_argument("--jobs", type=int, default=1, help="warm runtime planes side by side")
    parser.add_argument("--wall-s", type=float, default=WALL_S, help="longest wall time of one goal [s]")
    parser.add_argument("--sense", choices=("perceived", "truth"), default="perceived")
    parser.add_argument("--keep", type=Path, help="folder for the workspaces, kept afterwards")
    return parser.parse_args()


def read_results(path: Path, table: str) -> dict[int, GoalRecord]:
    """What ended before, by seed; a line that a kill cut off is run again."""
    known: dict[int, GoalRecord] = {}
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            record = GoalRecord.from_json(json.loads(line))
        except (ValueError, KeyError, TypeError):
            continue
        if record.table == table:
            known[record.seed] = record
    return known


if __name__ == "__main__":
    sys.exit(main())
