"""Worlds that nothing was made for: rooms, goals and faults drawn from seeds, judged by code of their own.

    paos bench run unseen --jobs 2 --run runs/unseen-1      # also unseen_slick (friction 0.1), unseen_grippy (1.0)
                                                        # and unseen_compound (bodies of several solids)
    python -m benchmarks.unseen runs/unseen-1

A seed is one goal of one to four nodes in one room of three to eight objects and more. Seeds below 100 000 are for
development; the held-out ones begin at 1 000 000, and nothing is tuned on them. About a third of the goals carry a
fault or an impossible detail. About a quarter of the nodes only claim something, which is false half of the time.

The judge (`oracle/predicates.py`) reads `scene.mjb` and `terminal.npz` with numpy and MuJoCo alone;
`oracle/feasible.py` decides by reach, opening, free volume and friction what can be met. Both import nothing of
the package. Where two honest judges may differ (1 mm, 1 degree, half the weight borne) a session is open: it counts
neither for nor against a verdict. An infeasible goal is refused before motion when no session of a node that cannot be
met moved the arm. Half of the goals with equal objects say that these are interchangeable: the judge then accepts every
naming. The others cannot be decided by looks: their nodes are listed, and count for false successes alone. A node that
was never begun, behind one that cannot be met or claims what is false, is no missed first attempt; it is counted apart.

What scene, goal and fault files cannot say yet is missing here: meshes and curved hollow walls (bowls, mugs and basins
are rings of flat walls), bodies outside of the inventory (flat coloured prints are seen and not reported), glassy or
black surfaces without depth, drawers, lids and doors of random make, volumes hidden under covers, and predicates on
metrics. Only rooms of unseen_compound have supports of several solids and objects that begin tilted.

The suite runs the goals; this judges every session of a run, and weighs it against what was feasible.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from rich.console import Console
from typer import Argument

from benchmarks.runner import finish, run
from benchmarks.unseen_parts.figures import ASKED, Tally
from benchmarks.unseen_parts.records import GoalRecord, Recorder, begin_record
from benchmarks.worlds.projects import read_case
from phyagentos.bench.records import EpisodeRecord, read_records


def main(run: Annotated[Path, Argument(help="folder of a run of such a suite")]) -> int:
    """Judge, show everything, and exit with whether every asked figure holds."""
    tally = Tally(judge(run, record) for record in read_records(run))
    tally.show(Console(), str(run))
    return finish(tally.build_figures(), ASKED)


def judge(run: Path, told: EpisodeRecord) -> GoalRecord:
    """One episode, judged; a process of it that wrote a traceback has crashed."""
    folder = run / told.folder
    case = read_case(folder / "project")
    if told.ended != "over":
        return begin_record(case, told)
    fallen = next(iter_tracebacks(folder / "workspace" / "logs"), "")
    judged = Recorder(case, run, told).record()
    return replace(judged, ended="crashed", error=fallen) if fallen else judged


def iter_tracebacks(logs: Path) -> Iterator[str]:
    """What workers, worlds and the watchdog raised."""
    for path in sorted(logs.glob("*.log")):
        written = path.read_text(errors="replace")
        if (begin := written.find("Traceback (most recent call last)")) >= 0:
            yield f"{path.name}: {written[begin : begin + 4000]}"


if __name__ == "__main__":
    run(main)
