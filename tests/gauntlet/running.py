"""Runs named tests in a process of their own, with a sabotage planted or without, and reads what became of each.

Upstream: `test_gauntlet` and the command `python -m tests.gauntlet`. Downstream: pytest, with `bend/` on its path.

The processes are forks of one that has imported pytest and the libraries, and nothing of our own.
"""

import json
import multiprocessing
import os
import re
import runpy
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from tests.gauntlet.sabotage import ROOT, Sabotage

BEND = Path(__file__).parent / "bend"
TIMEOUT_S = 300.0  # generous: what runs here takes seconds
ARGUMENTS = (
    "-q",
    "-p",
    "no:randomly",
    "-p",
    "no:xdist",
    "-p",
    "no:cacheprovider",
    "--tb=native",  # the others look for sources among all modules: as long as most tests take
    "-o",
    "junit_family=xunit1",
    "-W",
    "ignore:Module already imported:pytest.PytestAssertRewriteWarning",  # the fork has its plugins already
)
BREAKAGE = {  # what a badly made edit raises; a lie that nobody noticed must not pass for one that was found out
    "AttributeError",
    "ImportError",
    "IndentationError",
    "ModuleNotFoundError",
    "NameError",
    "SyntaxError",
    "TypeError",
    "UnboundLocalError",
}
LIBRARIES = (
    "pytest",
    "cv2",
    "hypothesis.strategies",
    "msgspec.yaml",
    "networkx",
    "numba",
    "pydantic",
    "py_trees",
    "scipy.interpolate",
    "scipy.optimize",
    "scipy.spatial",
    "typer",
    "tests.gauntlet.preloaded",
)
FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload([*LIBRARIES])
FRAME = re.compile(r'^  File "(.+)", line \d+, in ', re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one test.

    Attributes:
        node: Its id, parameters included.
        result: `passed`, `failed` (the test itself said no), or `broken` (it never came to its question).
        message: First line of what it said.
    """

    node: str
    result: str
    message: str = ""


@dataclass(frozen=True, slots=True)
class Run:
    """One pytest process: outcomes, how long it took [s], and what it printed."""

    outcomes: tuple[Outcome, ...]
    seconds: float
    output: str

    def find(self, node: str) -> tuple[Outcome, ...]:
        """The outcomes of a test: of all its parameters, when the id names none."""
        return tuple(each for each in self.outcomes if node in {each.node, each.node.partition("[")[0]})

    def is_green(self, node: str) -> bool:
        """Whether it ran and passed."""
        return bool(found := self.find(node)) and all(each.result == "passed" for each in found)

    def is_red(self, node: str) -> bool:
        """Whether it said no, for at least one of its parameters; one that broke says nothing."""
        found = self.find(node)
        return any(each.result == "failed" for each in found) and all(each.result != "broken" for each in found)


def run_tests(nodes: Iterable[str], sabotage: Sabotage | None = None) -> Run:
    """Run tests in a process of their own; once more where that left no report, having hung or died in its beginning.

    Args:
        nodes: Ids of the tests.
        sabotage: Planted in that process and in every one that it starts.
    """
    run = _run_once(wanted := [*nodes], sabotage)
    return run if run.outcomes else _run_once(wanted, sabotage)


def _run_once(nodes: Iterable[str], sabotage: Sabotage | None) -> Run:
    with tempfile.TemporaryDirectory(prefix="gauntlet-") as folder:
        report = Path(folder, "report.xml")
        environment = plant(sabotage, Path(folder))
        arguments = [*ARGUMENTS, f"--junitxml={report}", f"--basetemp={folder}/tmp", *nodes]
        process = FORKS.Process(target=_run_pytest, args=(arguments, environment, printed := Path(folder, "printed")))
        begin_s = time.perf_counter()
        process.start()
        process.join(TIMEOUT_S)
        seconds = time.perf_counter() - begin_s
        if process.is_alive():
            process.kill()
        outcomes = tuple(_read_report(report)) if report.exists() else ()
        said = printed.read_text(encoding="utf-8", errors="replace") if printed.exists() else ""
        return Run(outcomes, seconds, f"{said}(exit code {process.exitcode} after {seconds:.0f} s)")


def _run_pytest(arguments: Sequence[str], environment: dict[str, str], printed: Path) -> None:
    """In a fork: what a fresh `python -m pytest` in that environment would do."""
    with printed.open("wb") as file:
        for stream in (sys.stdout, sys.stderr):
            os.dup2(file.fileno(), stream.fileno())
    os.chdir(ROOT)
    os.environ.clear()
    os.environ.update(environment)
    if own := [name for name in sys.modules if name.partition(".")[0] in {"phyagentos", "skills"}]:
        raise RuntimeError(f"imported before the lie: {own}")
    runpy.run_path(str(BEND / "sitecustomize.py"))
    import pytest
    from hypothesis import Phase, settings

    settings.register_profile("unshrunk", phases=(Phase.explicit, Phase.generate))  # red needs no smallest example
    settings.load_profile("unshrunk")
    sys.exit(pytest.main([*arguments]))


def plant(sabotage: Sabotage | None, folder: Path) -> dict[str, str]:
    """The environment of a process in which a sabotage is planted; that of this process, for none.

    Args:
        sabotage: What to plant.
        folder: For the file of edits, and for examples that hypothesis finds: they are none of the honest code.
    """
    environment = {name: value for name, value in os.environ.items() if name != "GAUNTLET_EDITS"}
    environment["HYPOTHESIS_STORAGE_DIRECTORY"] = str(folder / "hypothesis")
    if sabotage is not None:
        edits: dict[str, list[tuple[str, str]]] = {}
        for edit in sabotage.edits:
            edits.setdefault(edit.module, []).append((edit.was, edit.becomes))
        file = folder / "edits.json"
        file.write_text(json.dumps(edits), encoding="utf-8")
        path = os.pathsep.join(filter(None, (str(BEND), environment.get("PYTHONPATH"))))
        environment |= {"GAUNTLET_EDITS": str(file), "PYTHONPATH": path}
    return environment


def _read_report(report: Path) -> Iterable[Outcome]:
    for case in ElementTree.parse(report).getroot().iter("testcase"):
        node = f"{case.get('file')}::{case.get('name')}"
        failure = case.find("failure")
        if failure is not None:
            message = (failure.get("message") or "").partition("\n")[0]
            yield Outcome(node, "broken" if _is_breakage(message, failure.text or "") else "failed", message)
        elif (error := next((each for each in case if each.tag in {"error", "skipped"}), None)) is not None:
            yield Outcome(node, "broken", (error.get("message") or "").partition("\n")[0])
        else:
            yield Outcome(node, "passed")


def _is_breakage(message: str, traceback: str) -> bool:
    """Whether a test ended by a mistake of the edit, or by the clock, rather than by its own question.

    What the test itself trips over is its answer: `reply.code` of a step where it had asked for a refusal.
    """
    kind = message.partition(":")[0].rpartition(".")[2]
    frames = FRAME.findall(traceback)
    is_of_test = bool(frames) and Path(frames[-1]).is_relative_to(ROOT / "tests")
    return (kind in BREAKAGE and not is_of_test) or message.startswith("Failed: Timeout")
