"""What the benchmark's own code says: its environment, sequences, instructions and oracles, from the user's clone.

The files are imported as they are. What they import for learned policies alone (torch, models, a hash) is stood in for.
"""

import json
import sys
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import hydra
from omegaconf import OmegaConf

SEQUENCES = 1000  # that the benchmark draws, whatever number of them is run
SCENE = "calvin_scene_D"


class Hasher:
    """FNV-1 of 32 bits from 0, by which an initial state seeds where blocks are."""

    def __call__(self, text: str) -> int:
        value = 0
        for byte in text.encode():
            value = value * 0x01000193 % 2**32 ^ byte
        return value


_STOOD_IN: dict[str, dict[str, Any]] = {
    "torch": {},
    "pyhash": {"fnv1_32": Hasher},
    "calvin_agent.models.mcil": {"MCIL": None},
    "calvin_agent.utils.utils": {"add_text": None, "format_sftp_path": None},
}
"""Modules that only learned policies use, with what is imported of them."""


def _import(name: str) -> Any:
    added = [other for other in _STOOD_IN if other not in sys.modules]
    for other in added:
        sys.modules[other] = ModuleType(other)
        sys.modules[other].__dict__.update(_STOOD_IN[other])
    try:
        return import_module(f"calvin_agent.evaluation.{name}")
    finally:
        for other in added:  # who looks for torch later, as scipy does, finds that there is none
            del sys.modules[other]


def open_environment() -> Any:
    """Scene D with the arm of the recorded data, without cameras."""
    folder = Path(str(import_module("calvin_env").__file__)).parents[1]
    with hydra.initialize_config_dir(str(folder / "conf"), version_base="1.1"):
        config = hydra.compose("config_data_collection", overrides=[f"scene={SCENE}", "cameras=no_cameras"])
    config.scene.data_path = str(folder / "data")
    config.robot.filename = str(folder / "data" / config.robot.filename)
    return hydra.utils.instantiate(config.env, show_gui=False, use_vr=False, use_egl=False, use_scene_info=True)


@cache
def _read_sequences() -> list[tuple[dict[str, Any], list[str]]]:
    """Initial states and names of tasks; drawn once, which takes minutes, and kept in this Python environment."""
    kept = Path(sys.prefix) / "calvin_sequences.json"
    if not kept.exists():
        drawn = _import("multistep_sequences").get_sequences(SEQUENCES, 1)
        text = json.dumps([(state, [*map(str, names)]) for state, names in drawn])
        kept.write_text(text)
    found: list[tuple[dict[str, Any], list[str]]] = json.loads(kept.read_text())
    return found


def read_names(sequence: int) -> list[str]:
    """The tasks of a sequence, by which the oracles are named."""
    return _read_sequences()[sequence][1]


def read_start(sequence: int) -> tuple[Any, Any]:
    """Initial state of robot and scene."""
    state, _ = _read_sequences()[sequence]
    found: tuple[Any, Any] = _import("utils").get_env_state_for_initial_condition(state)
    return found


def _read_config(name: str) -> Any:
    return OmegaConf.load(Path(str(import_module("calvin_agent").__file__)).parents[1] / "conf" / name)


def read_instructions(sequence: int) -> list[str]:
    """Its instructions of the validation set, in order."""
    texts = _read_config("annotations/new_playtable_validation.yaml")
    return [str(texts[name][0]) for name in read_names(sequence)]


class Scorer:
    """The official oracle of one instruction after the other; what it finds goes to a file alone.

    Attributes:
        reached: Whether it was met after some step, where a published evaluation ends the instruction.
    """

    def __init__(self, outcomes: str) -> None:
        self._outcomes = outcomes
        self._oracle = hydra.utils.instantiate(_read_config("callbacks/rollout/tasks/new_playtable_tasks.yaml"))

    def begin(self, sequence: int, number: int, info: Mapping[str, Any]) -> None:
        """An instruction begins in this state."""
        self._at, self._name, self._start = (sequence, number), read_names(sequence)[number], info
        self.reached, self._steps, self._holds = False, 0, False

    def look(self, info: Mapping[str, Any]) -> None:
        """A step has ended in this state."""
        self._holds = bool(self._oracle.get_task_info_for_set(self._start, info, {self._name}))
        self._steps += 1
        if self._holds and not self.reached:
            self.reached, self._reached_at = True, self._steps

    def note(self, session: str) -> None:
        """Append what holds at the end of a session."""
        line = {"session": session, "sequence": self._at[0], "number": self._at[1], "task": self._name}
        line |= {"success": self._holds, "reached": self.reached, "steps": self._steps}
        line["reached_at"] = self._reached_at if self.reached else None
        with Path(self._outcomes).open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
