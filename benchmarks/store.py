"""What the protocol store costs: CPU, waits for the disk, latency of a transition, start and memory.

    python benchmarks/store.py            # some four minutes
    python benchmarks/store.py --quick    # small numbers, for a look

Times that depend on the disk are given as multiples of a bare write and fdatasync in the same run, in turns with it.
CPU and start are the least of several tries: what others do on the machine only adds. Folders are made below
the working directory, because the temporary one may be held in memory.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from typer import Option

from benchmarks.runner import finish, run, show, show_figures
from benchmarks.store_parts.cost import count_waits, measure_cpu
from benchmarks.store_parts.sessions import open_pair, scratch, store_many
from benchmarks.store_parts.start import measure_start
from benchmarks.store_parts.transitions import measure_transitions
from phyagentos.bench.report import Threshold

ASKED = {
    "cpu_ms_per_session": Threshold(0.35, at_least=False),
    "waits_per_session": Threshold(3, at_least=False),
    "transition_p50_in_waits": Threshold(2, at_least=False),
    "transition_p50_growth": Threshold(1.2, at_least=False),
    "start_ms_above_interpreter": Threshold(100, at_least=False),
    "start_bytes_per_known_session": Threshold(1000, at_least=False),
}


@dataclass(frozen=True, slots=True)
class Size:
    """How much of everything."""

    serial: int
    stored: tuple[int, ...]
    windows: int
    starts: int


FULL = Size(3500, (0, 1000, 100_000), 15, 15)
QUICK = Size(350, (0, 100, 1000), 7, 3)


def measure(size: Size) -> tuple[dict[str, float], list[Sequence[str]]]:
    """Every figure, and the rows of the table of transitions."""
    figures: dict[str, float] = {}
    with scratch() as root:
        figures |= measure_cpu(root / "cpu", size.serial)
        figures |= count_waits(root / "waits", 50)
        roots = {stored: root / f"stored{stored}" for stored in size.stored}
        for stored, place in roots.items():
            for journal in open_pair(place, durable=False):
                journal.close()
            store_many(place, stored)
        figures |= measure_start(roots[max(roots)], roots[0], size.starts)
        transitions, rows = measure_transitions(roots, size.windows)
    return figures | transitions, rows


def main(*, quick: Annotated[bool, Option(help="Small numbers; only the counts mean anything.")] = False) -> int:
    """Measure, show, and exit with whether every asked figure holds."""
    size = QUICK if quick else FULL
    figures, rows = measure(size)
    columns = ("sessions stored", "p50 (ms)", "p50 (bare waits)", "p99 (bare waits)")
    show(f"durable transitions; bare fdatasync p50: {figures['fdatasync_p50_ms']:.3f} ms", columns, rows)
    show_figures(f"the store; {max(size.stored)} sessions archived", figures, ASKED)
    return finish(figures, ASKED)


if __name__ == "__main__":
    run(main)
