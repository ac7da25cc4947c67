"""Projects as suites draw them from seeds: rooms with goals and faults, and instances of one skill each.

A suite names `draw_unseen`, `draw_slick`, `draw_grippy` or `draw_compound`; `draw_press`, `draw_spoilt_press` and so
on.
"""

import pkgutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import yaml

from benchmarks.worlds.cases import Case
from benchmarks.worlds.files import render_goal, render_scene, write_project
from benchmarks.worlds.goals import draw_case
from benchmarks.worlds.instances import DRAWERS, draw
from benchmarks.worlds.rooms import COMPOUND, USUAL, Style

CASE, TRUTH = "case", "truth"  # of a drawn project: which function made its case, from which seed; what the oracle asks
STYLES = {
    "unseen": USUAL,
    "slick": Style(friction=(0.1, 0.1), is_even=True),
    "grippy": Style(friction=(1.0, 1.0), is_even=True),
    "compound": COMPOUND,
}


def write_case(case: Case, folder: Path, maker: str = f"{__name__}:make_unseen", **graph: Any) -> Path:
    """Write a case as a project; `maker` makes it again from its seed, `graph` replaces keys of its goal graph."""
    faults = {"version": 1, "faults": [dict(fault) for fault in case.faults]}  # each episode has a world of its own
    made = {CASE: {"maker": maker, "seed": case.seed}}
    scene = render_scene(case.room, case.name)
    return write_project(folder, scene, render_goal(case) | graph, faults=faults, **made)


def read_case(project: Path) -> Case:
    """The case that a project was written from."""
    made = yaml.safe_load((project / f"{CASE}.yaml").read_text())
    case: Case = pkgutil.resolve_name(made["maker"])(made["seed"])
    return case


def write_instance(skill: str, seed: int, folder: Path, *, spoilt: bool = False) -> Path:
    """Write the project of an instance of a skill; its goal graph."""
    one = draw(skill, seed, spoilt=spoilt)
    return write_project(folder, one.as_scene(), one.as_goal(), **{TRUTH: list(one.truth or one.accept)})


def __getattr__(name: str) -> Callable[..., Any]:
    action, _, what = name.partition("_")
    if action == "make" and what in STYLES:
        return partial(draw_case, style=STYLES[what])
    if action == "draw" and what in STYLES:
        return lambda seed, folder: write_case(__getattr__(f"make_{what}")(seed), folder, f"{__name__}:make_{what}")
    if action == "draw" and (skill := what.removeprefix("spoilt_")) in DRAWERS:
        return partial(write_instance, skill, spoilt=what != skill)
    raise AttributeError(name)
