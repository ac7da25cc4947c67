"""Runs named tests in a process of their own, with a mutant planted or without, and reads what became of each."""

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from tests.mutants.mutant import ROOT, Mutant

BEND = Path(__file__).parent / "bend"
TIMEOUT_S = 900.0  # generous: what runs here takes seconds
PLUGINS = ("tests.mutants.unshrunk", "no:randomly", "no:xdist", "no:cacheprovider")
OPTIONS = ("-q", "--tb=native", "-o", "junit_family=xunit1")
BREAKAGE = {  # what a badly made edit raises; it must not pass for a mutant that was found out
    "AttributeError",
    "ImportError",
    "IndentationError",
    "ModuleNotFoundError",
    "NameError",
    "SyntaxError",
    "TypeError",
    "UnboundLocalError",
}
FRAME = re.compile(r'^  File "(.+)", line \d+, in ', re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one test.

    Attributes:
        node: Its id, parameters included.
        result: `passed`, `failed` (the test itself said no), or `broken` (it never came to its question).
    """

    node: str
    result: str


@dataclass(frozen=True, slots=True)
class Run:
    """One pytest process: outcomes, how long it took [s], and what it printed."""

    outcomes: tuple[Outcome, ...]
    seconds: float
    output: str

    def find(self, node: str) -> set[str]:
        """The results of a test: of all its parameters, when the id names none."""
        return {each.result for each in self.outcomes if node in {each.node, each.node.partition("[")[0]}}

    def is_green(self, node: str) -> bool:
        """Whether it ran and passed."""
        return self.find(node) == {"passed"}

    def is_red(self, node: str) -> bool:
        """Whether it said no, for at least one of its parameters; one that broke says nothing."""
        return "failed" in (found := self.find(node)) and "broken" not in found


def run_tests(nodes: Iterable[str], mutant: Mutant | None = None) -> Run:
    """Run tests by their ids in a process of their own; the mutant is in it and in every process that it starts."""
    begin_s = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="mutant-") as folder:
        report, printed = Path(folder, "report.xml"), Path(folder, "printed")
        plugins = [part for name in PLUGINS for part in ("-p", name)]
        files = [f"--junitxml={report}", f"--basetemp={folder}/tmp"]
        command = [sys.executable, "-m", "pytest", *OPTIONS, *plugins, *files, *nodes]
        with printed.open("wb") as output:
            process = subprocess.Popen(command, cwd=ROOT, env=plant(mutant, Path(folder)), stdout=output, stderr=output)
            try:
                process.wait(TIMEOUT_S)
            except subprocess.TimeoutExpired:
                process.kill()
        outcomes = tuple(_read_report(report)) if report.exists() else ()
        return Run(outcomes, time.perf_counter() - begin_s, printed.read_text(encoding="utf-8", errors="replace"))


def plant(mutant: Mutant | None, folder: Path) -> dict[str, str]:
    """The environment of a process in which a mutant is planted; without one, that of this process.

    Args:
        mutant: What to plant.
        folder: For the bent sources, and for examples that hypothesis finds: they are none of the honest code.
    """
    environment = os.environ | {"HYPOTHESIS_STORAGE_DIRECTORY": str(folder / "hypothesis")}
    if mutant is not None:
        file = folder / "sources.json"
        file.write_text(json.dumps(mutant.bend()), encoding="utf-8")
        path = os.pathsep.join(filter(None, (str(BEND), environment.get("PYTHONPATH"))))
        environment |= {"BENT_SOURCES": str(file), "PYTHONPATH": path}
    return environment


def _read_report(report: Path) -> Iterable[Outcome]:
    for case in ElementTree.parse(report).getroot().iter("testcase"):
        node = f"{case.get('file')}::{case.get('name')}"
        if (failure := case.find("failure")) is not None:
            is_broken = _is_breakage(failure.get("message") or "", failure.text or "")
            yield Outcome(node, "broken" if is_broken else "failed")
        else:
            yield Outcome(node, "broken" if {each.tag for each in case} & {"error", "skipped"} else "passed")


def _is_breakage(message: str, traceback: str) -> bool:
    """Whether a test ended by a mistake of the edit, or by the clock, rather than by its own question.

    What the test itself trips over is its answer: `reply.code` of a step where it had asked for a refusal.
    """
    kind = message.partition(":")[0].rpartition(".")[2]
    frames = FRAME.findall(traceback)
    is_of_test = bool(frames) and Path(frames[-1]).is_relative_to(ROOT / "tests")
    return (kind in BREAKAGE and not is_of_test) or message.startswith("Failed: Timeout")
