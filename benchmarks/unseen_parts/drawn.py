"""Rooms, goals and faults as a suite draws them, and the scorer that judges their end."""

import pkgutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.unseen_parts.cases import Case
from benchmarks.unseen_parts.files import FOLDER, render_goal, render_scene
from benchmarks.unseen_parts.goals import draw_case
from benchmarks.unseen_parts.records import judge_end
from phyagentos.bench.scorers.scorer import Scorer

CASE = "case.yaml"  # of a drawn project: which function made its case, and from which seed
FRICTION = {"unseen": (0.2, 0.6), "slick": (0.1, 0.1), "grippy": (1.0, 1.0)}
ENDED = ("scene.mjb", "initial.npz", "terminal.npz")


def draw_unseen(seed: int, folder: Path) -> Path:
    """Write the project of a seed; its goal graph."""
    return write_case(make_unseen(seed), folder, "make_unseen")


def draw_slick(seed: int, folder: Path) -> Path:
    """The same, where nothing has grip."""
    return write_case(make_slick(seed), folder, "make_slick")


def draw_grippy(seed: int, folder: Path) -> Path:
    """The same, where everything has."""
    return write_case(make_grippy(seed), folder, "make_grippy")


def make_unseen(seed: int) -> Case:
    """The case of a seed with usual friction."""
    return draw_case(seed, friction=FRICTION["unseen"])


def make_slick(seed: int) -> Case:
    """The case of a seed with little friction."""
    return draw_case(seed, friction=FRICTION["slick"])


def make_grippy(seed: int) -> Case:
    """The case of a seed with much friction."""
    return draw_case(seed, friction=FRICTION["grippy"])


def write_case(case: Case, folder: Path, maker: str, **graph: Any) -> Path:
    """Write a case as a project; `maker` makes it again from its seed, `graph` replaces keys of its goal graph."""
    path = folder / "goal_graphs" / f"{case.name}.yaml"
    faults = [dict(fault) for fault in case.faults]  # each episode has a world of its own
    files = {
        folder / "scenes" / FOLDER / f"{case.name}.yaml": render_scene(case.room, case.name),
        path: render_goal(case) | graph,
        folder / "faults.yaml": {"version": 1, "faults": faults},
        folder / CASE: {"maker": maker if ":" in maker else f"{__name__}:{maker}", "seed": case.seed},
    }
    for file, data in files.items():
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(yaml.safe_dump(data, sort_keys=False, allow_unicode=True))
    return path


def read_case(project: Path) -> Case:
    """The case that a project was written from."""
    made = yaml.safe_load((project / CASE).read_text())
    case: Case = pkgutil.resolve_name(made["maker"])(made["seed"])
    return case


def _score(parts: Mapping[str, Any], workspace: Path, bundle: Path | None) -> dict[str, bool] | None:
    """The goal's own acceptance at its end; where two honest judges may differ, it cannot be said."""
    if bundle is not None:
        return None  # sessions are judged by `benchmarks.unseen`
    ended = [f for f in (workspace / "evidence").glob("*.*") if all((f / name).exists() for name in ENDED)]
    if not ended:
        return dict.fromkeys(parts, False)
    first = min(ended, key=lambda bundle: _read_time(bundle / "initial.npz"))
    last = max(ended, key=lambda bundle: _read_time(bundle / "terminal.npz"))
    truth, _ = judge_end(read_case(workspace.parent / "project"), last, first)
    return dict.fromkeys(parts, truth == "met") if truth in {"met", "unmet"} else None


def _read_time(state: Path) -> float:
    with np.load(state) as stored:
        return float(stored["time"])


JUDGE = Scorer(name="unseen", check=lambda located, path, condition: [], score=_score)
