"""Crash and damage: the fault-injection suite of the store, with its figures in one table.

    python benchmarks/durability.py             # the counts of every run: about a minute
    python benchmarks/durability.py --nightly   # the counts of a night

Runs tests/durability and collects what each test tells: what was killed, cut, damaged or made to fail, what had been
acknowledged, and what was lost. A figure that must be 0 counts broken promises. Stores that do not sync, lock or check
are mutants: `make mutants`.
"""

from collections import Counter
from pathlib import Path
from typing import Annotated

import pytest
from typer import Option

from benchmarks.runner import finish, run, show
from phyagentos.bench.report import Threshold

ROOT = Path(__file__).resolve().parents[1]
BROKEN_PROMISES = ("lost", "torn_exposed", "vanished", "broken_batches", "readers_differ", "folds_differ", "accepted")
TOLD = ("kills", "cuts", "images", "faults", "damages", "acknowledged", "cut", "repairs", *BROKEN_PROMISES)


class Collector:
    """Gathers the properties that tests record, those of one test's variants together, and how the tests end."""

    def __init__(self) -> None:
        self.told: dict[str, Counter[str]] = {}
        self.tests, self.failed = 0, 0

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Called by pytest after each phase of each test."""
        self.failed += report.failed
        if report.when == "call":
            self.tests += 1
            name = report.nodeid.rpartition("::test_")[2].partition("[")[0].replace("_", " ")
            told = {key: int(str(value)) for key, value in report.user_properties}
            self.told.setdefault(name, Counter()).update(told)


def main(*, nightly: Annotated[bool, Option(help="large counts")] = False) -> int:
    """Run, show, and exit with whether every promise was kept."""
    collector = Collector()
    options = ["--nightly"] if nightly else []
    code = pytest.main([str(ROOT / "tests" / "durability"), f"--rootdir={ROOT}", "-q", *options], plugins=[collector])

    totals: Counter[str] = Counter(dict.fromkeys(TOLD, 0))
    for told in collector.told.values():
        totals.update({key: value for key, value in told.items() if key in totals})
    rows = ((name, ", ".join(f"{key} {value}" for key, value in told.items())) for name, told in collector.told.items())
    show("faults, and what became of what was acknowledged", ("test", "figures"), sorted(rows), width=140)

    figures = {name: float(value) for name, value in totals.items()}
    figures |= {"tests": float(collector.tests), "tests_failed": float(collector.failed)}
    never = Threshold(0, at_least=False)
    asked = {"tests_failed": never, **dict.fromkeys(BROKEN_PROMISES, never)}
    return finish(figures, asked) or int(code)


if __name__ == "__main__":
    run(main)
