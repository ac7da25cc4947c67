"""Models of robots as they are published: whether each gives a draft that its own check and picture accept.

    PHYAGENTOS_MODELS=FOLDER python benchmarks/models.py FOLDER...
    python benchmarks/models.py FOLDER --tried --match z1      # and tried alone in simulation

Every MJCF, URDF and xacro file below the folders that describes a robot is drafted, checked and drawn, in a process of
its own; a refusal of the draft is printed whole. A check or picture that refuses a draft, and what raises anything but
a problem of its file, is a fault of ours: the figures `refused_later` and `crashed`.
"""

import multiprocessing
import os
import re
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from benchmarks.runner import finish, run, show
from phyagentos.assembly.graphics import choose_graphics
from phyagentos.bench.report import Threshold
from phyagentos.errors import DefinitionError
from phyagentos.operations import robots
from phyagentos.runtime.models.sources import MODELS

ASKED = {"refused_later": Threshold(0.0, at_least=False), "crashed": Threshold(0.0, at_least=False)}
STEPS = ("draft", "check", "render", "try")
LIMIT_S = 600.0
_ROBOT = re.compile(r"<robot\b|<mujoco\b[^i]")
_MOVES = re.compile(r"<(joint|freejoint)\b|<xacro:")


@dataclass(frozen=True, slots=True)
class Row:
    """What became of a model: the outcome of each step that was reached, and all that was said on the way."""

    model: str
    outcomes: tuple[str, ...]
    says: tuple[str, ...]


def iter_models(folder: Path) -> Iterator[Path]:
    """Files of robots below a folder; scenes and parts of files without a joint are none."""
    for file in sorted({*folder.rglob("*.xml"), *folder.rglob("*.urdf"), *folder.rglob("*.xacro")}):
        text = file.read_text(encoding="utf-8", errors="replace")
        if _ROBOT.search(text) and _MOVES.search(text) and not file.stem.startswith("scene"):
            yield file


def try_model(file: Path, *, is_tried: bool) -> Row:
    """Draft, check and draw a model, in a project of its own below the working folder; and try it where `is_tried`."""
    outcomes, says, name = list[str](), list[str](), "mine"
    try:
        drafted = robots.draft_robot(str(file), Path(), name)
        outcomes.append(f"ok, {len(drafted.asks)} asked")
        if drafted.models is not None:
            os.environ[MODELS] = str(drafted.models)
        problems = robots.check_robot(name).problems
        outcomes.append("refused" if problems else "ok")
        says += map(str, problems)
        robots.render_robot(name, Path("robot.png"))
        outcomes.append("ok")
        if is_tried and not problems:
            trial = robots.try_robot(name, Path("reach.png"))
            bad = [f"{each.what}: {each.measured}" for each in trial.findings if not each.well]
            outcomes.append("not well" if bad else "ok")
            says += bad
    except DefinitionError as error:
        outcomes.append("refused")
        says += map(str, error.problems)
    except Exception as error:  # what no user should see is what is looked for here
        outcomes.append("crashed")
        says.append(f"{type(error).__name__}: {error}")
    return Row(str(file), tuple(outcomes), tuple(says))


def _send(file: Path, folder: Path, is_tried: bool, out: Connection) -> None:
    os.chdir(folder)
    choose_graphics()
    with redirect_stdout(StringIO()):
        out.send(try_model(file, is_tried=is_tried))


def measure_model(file: Path, to: Path, *, is_tried: bool) -> Row:
    """As of `try_model`, in a process of its own; `to` keeps its project."""
    to.mkdir(parents=True)
    own, other = multiprocessing.Pipe(duplex=False)
    process = multiprocessing.get_context("fork").Process(target=_send, args=(file.resolve(), to, is_tried, other))
    process.start()
    other.close()
    try:
        return own.recv() if own.poll(LIMIT_S) else Row(str(file), ("crashed",), (f"no end within {LIMIT_S:g} s",))
    except EOFError:
        return Row(str(file), ("crashed",), (f"its process ended with {process.exitcode}",))
    finally:
        process.kill()
        process.join()


def measure(
    folders: Annotated[list[Path], Argument(metavar="FOLDER...", help="Of models, at any depth.")],
    match: Annotated[str, Option(help="Part of a path; only such files.")] = "",
    tried: Annotated[bool, Option("--tried", help="Also try each alone in simulation.")] = False,
    keep: Annotated[Path | None, Option(metavar="DIR", help="Where projects and pictures stay.")] = None,
) -> int:
    """Draft, check and draw every model, and print a table."""
    place, rows = keep or Path(tempfile.mkdtemp()), list[Row]()
    for folder in folders:
        for file in [each for each in iter_models(folder) if match in str(each)]:
            row = measure_model(file, place.resolve() / f"{len(rows):03}", is_tried=tried)
            shown = str(file.relative_to(folder))
            rows.append(Row(shown, row.outcomes, row.says))
            print("\n  ".join((f"{len(rows) - 1:03} {shown}: {', '.join(row.outcomes)}", *row.says)), flush=True)
    show("models", ("model", *STEPS), ((row.model, *row.outcomes) for row in rows), width=160)
    ends = Counter(row.outcomes[0].partition(",")[0] for row in rows)
    later = sum("refused" in row.outcomes[1:] for row in rows)
    crashed = sum("crashed" in row.outcomes for row in rows)
    figures = {"models": len(rows), "drafted": ends["ok"], "refused_later": later, "crashed": crashed}
    return finish(figures, ASKED)


if __name__ == "__main__":
    run(measure)
