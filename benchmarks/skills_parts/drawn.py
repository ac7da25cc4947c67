"""Instances of skills as a suite draws them, and their scorer: `draw_press`, `draw_spoilt_press`, and so on."""

import json
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.skills_parts.judge import Judge
from benchmarks.skills_parts.rooms import DRAWERS, draw
from phyagentos.bench.scorers.scorer import Scorer

TRUTH = "truth.json"  # of a drawn project: what the judge demands


def write(skill: str, seed: int, folder: Path, *, spoilt: bool = False) -> Path:
    """Write the project of an instance; its goal graph."""
    one = draw(skill, seed, spoilt=spoilt)
    graph, scene = folder / "goal_graphs" / f"{one.name}.yaml", folder / "scenes" / "skills" / f"{one.name}.yaml"
    for path, data in ((scene, one.as_scene()), (graph, one.as_goal())):
        path.parent.mkdir(parents=True)
        path.write_text(yaml.safe_dump(data, sort_keys=False))
    (folder / TRUTH).write_text(json.dumps(one.truth))
    return graph


def __getattr__(name: str) -> Callable[[int, Path], Path]:
    skill = name.removeprefix("draw_").removeprefix("spoilt_")
    if not name.startswith("draw_") or skill not in DRAWERS:
        raise AttributeError(name)
    return partial(write, skill, spoilt=name.startswith("draw_spoilt_"))


def _score(parts: Mapping[str, Any], workspace: Path, bundle: Path | None) -> dict[str, bool]:
    """Whether every demanded fact is so after a session, or after the last one; compared with the beginning."""
    ended = [f for f in (workspace / "evidence").glob("*.*") if (f / "terminal.npz").exists()]
    if not ended or (bundle is not None and bundle not in ended):
        return dict.fromkeys(parts, False)
    start = min(ended, key=lambda each: _read_time(each / "initial.npz"))
    end = bundle or max(ended, key=lambda each: _read_time(each / "terminal.npz"))
    truth = json.loads((workspace.parent / "project" / TRUTH).read_text())
    return dict.fromkeys(parts, not Judge(end, start).find_unmet(truth))


def _read_time(state: Path) -> float:
    with np.load(state) as stored:
        return float(stored["time"])


INSTANCE = Scorer(name="instance", check=lambda located, path, condition: [], score=_score)
