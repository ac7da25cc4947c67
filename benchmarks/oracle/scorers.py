"""Scorers of drawn projects: acceptance of a room, what an instance of a skill demands, what a policy let go."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from benchmarks.oracle.acceptance import judge_end
from benchmarks.oracle.moment import Moment, read_time
from benchmarks.oracle.skill_facts import SkillJudge
from benchmarks.worlds.projects import TRUTH, read_case
from phyagentos.bench.scorers.scorer import Scorer
from phyagentos.bench.scorers.simulator_state import is_in_tray

ENDED = ("scene.mjb", "initial.npz", "terminal.npz")


def _score_case(parts: Mapping[str, Any], workspace: Path, bundle: Path | None) -> dict[str, bool] | None:
    """The goal's own acceptance at its end; where two honest judges may differ, it cannot be said."""
    if bundle is not None:
        return None  # sessions are judged by `benchmarks.unseen`
    if not (ended := _list_ended(workspace)):
        return dict.fromkeys(parts, False)
    truth, _ = judge_end(read_case(workspace.parent / "project"), ended[-1], _find_first(ended))
    return dict.fromkeys(parts, truth == "met") if truth in {"met", "unmet"} else None


def _score_instance(parts: Mapping[str, Any], workspace: Path, bundle: Path | None) -> dict[str, bool]:
    """Whether everything that is demanded is so after a session, or after the last one; `moved` is since the first."""
    ended = _list_ended(workspace)
    if not ended or (bundle is not None and bundle not in ended):
        return dict.fromkeys(parts, False)
    judge = SkillJudge(bundle or ended[-1], _find_first(ended))
    asked = yaml.safe_load((workspace.parent / "project" / f"{TRUTH}.yaml").read_text())
    return dict.fromkeys(parts, all(judge.judge(text) >= 0 for text in asked))


def _score_let_go(parts: Mapping[str, Any], workspace: Path, bundle: Path | None) -> dict[str, bool]:
    """Whether each object lies in its tray, out of the hand, after a session, or after the last one.

    What was let go into the tray by a session that only went back to the beginning counts where no verdict was asked.
    """
    ended = [each for each in _list_ended(workspace) if bundle in {None, each}]
    found = {part: bool(ended) and _is_let_go(ended[-1], *names) for part, names in parts.items()}
    sessions = [yaml.safe_load((each / "contract.yaml").read_text())["session"] for each in ended]
    backs = [each for each, session in zip(ended, sessions, strict=True) if session["skill"] == "start_over"]
    if bundle or any("metric" in text for session in sessions for text in session.get("accept", ())):
        return found
    return {part: met and not any(_is_let_go(each, *parts[part]) for each in backs) for part, met in found.items()}


def _is_let_go(bundle: Path, item: str, tray: str) -> bool:
    end = Moment.read(bundle)
    touching = {end.model.body(body).name for body in end.find_touching(item)}
    return is_in_tray(bundle, item, tray) and not any("finger" in name or "hand" in name for name in touching)


def _list_ended(workspace: Path) -> list[Path]:
    """Bundles with a recorded end, in the order of these ends."""
    ended = [f for f in (workspace / "evidence").glob("*.*") if all((f / name).exists() for name in ENDED)]
    return sorted(ended, key=lambda bundle: read_time(bundle / "terminal.npz"))


def _find_first(ended: list[Path]) -> Path:
    return min(ended, key=lambda bundle: read_time(bundle / "initial.npz"))


UNSEEN = Scorer(name="unseen", check=lambda located, path, condition: [], score=_score_case)
INSTANCE = Scorer(name="instance", check=lambda located, path, condition: [], score=_score_instance)
LET_GO = Scorer(name="let_go", check=lambda located, path, condition: [], score=_score_let_go)
