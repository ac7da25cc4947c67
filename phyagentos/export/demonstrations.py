"""Verified sessions as demonstrations: what was observed and commanded, on a grid of equal steps of time.

Upstream: journal and evidence bundles. Downstream: `export.lerobot`. Sessions whose verdict does not rest on evidence
are left out, and those that missed unless they are wanted.
"""

import io
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from typing_extensions import override

from phyagentos.errors import DefinitionError, Problem, format_names, raise_any
from phyagentos.protocol.capabilities.registries import get_registered_target
from phyagentos.protocol.documents.packed_files import check_picture, open_packed
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.predicates.predicate import find_question
from phyagentos.protocol.sessions.evidence import BEFORE, TRAJECTORY
from phyagentos.protocol.sessions.evidence_manifest import check_bundle
from phyagentos.protocol.sessions.lifecycle import SessionState
from phyagentos.protocol.sessions.recording import RECORDING, RecordedPicture, read_recording
from phyagentos.protocol.sessions.session import SessionStatus
from phyagentos.protocol.sessions.verdicts import PERSON, Attempt, Verdict
from phyagentos.protocol.workspace.array_files import read_arrays
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import Environment
from phyagentos.store.history import fold_partition
from phyagentos.store.journal import choose_partition

Array = NDArray[np.float32]
POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
_VERIFIED = {SessionState.SUCCEEDED, SessionState.FAILED, SessionState.REPLANNED}
_TOLERANCE_S = 1e-6  # sums of control periods are not exact


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """What of the verified sessions is wanted.

    Attributes:
        target: Only sessions of this target; empty for the one that there is.
        cameras: Whose recorded pictures are wanted.
        entities: Whose pose, as believed before the first command, is wanted: objects, or parameters that name one.
        fps: Steps a second; 0 for the control rate.
        contested: Also sessions whose verdict a person contests, labelled so.
        failures: Also sessions whose verdict is failure or replan, labelled so.
    """

    skills: tuple[str, ...] = ()
    target: str = ""
    cameras: tuple[str, ...] = ()
    entities: tuple[str, ...] = ()
    fps: int = 0
    contested: bool = False
    failures: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Episode(ABC):
    """One motion on a grid of equal steps of time.

    Attributes:
        state: (n, d) measured joint positions [rad] and, where the target has one, opening of its gripper [m].
        action: (n, d) set-points in force one step later, alike.
        world: (k,) poses of the wanted entities before the first command: position [m] and quaternion, world frame.
    """

    task: str
    state: Array
    action: Array
    world: Array

    @property
    @abstractmethod
    def origin(self) -> Fields:
        """Where it is from, and what says that it shows its task: columns of `meta/episodes`."""

    @abstractmethod
    def iter_pictures(self, camera: str) -> Iterator[NDArray[np.uint8]]:
        """The pictures (height, width, 3) of a camera, one for each step."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Demonstration(Episode):
    """One session with its verdict.

    Attributes:
        led_by: Who took the arm over in its midst; empty without a take-over.
        contested: Who contests the verdict, when and why; empty where none does.
        pictures: By camera, n pictures: the latest that it showed at each step.
    """

    session: str
    bundle: Path
    skill: str
    seed: int
    verdict: Attempt
    pictures: dict[str, tuple[RecordedPicture, ...]]
    contested: str = ""
    led_by: str = ""

    @property
    @override
    def origin(self) -> Fields:
        people = [f"{one.text} {one.because}" for one in self.verdict.criteria if find_question(one.text)]
        return {
            "session_id": self.session,
            "bundle": str(self.bundle),
            "skill": self.skill,
            "seed": self.seed,
            "verdict": self.verdict.verdict.value,
            "cause": self.verdict.cause,
            "verdict_reason": self.verdict.reason,
            "answers": "; ".join(people),
            "contested": self.contested,
            "led_by": self.led_by,
            "sensing": self.verdict.sensing,
            "verifier": self.verdict.verifier,
        }

    @override
    def iter_pictures(self, camera: str) -> Iterator[NDArray[np.uint8]]:
        name, rgb = "", np.zeros(0, np.uint8)
        with open_packed(self.bundle / RECORDING) as file:
            for picture in self.pictures[camera]:
                if picture.rgb != name:
                    png = io.BytesIO(check_picture(file.read(picture.rgb)))
                    name, rgb = picture.rgb, np.asarray(Image.open(png).convert("RGB"))
                yield rgb


@dataclass(frozen=True, slots=True, kw_only=True)
class Demonstrations:
    """Demonstrations of one target.

    Attributes:
        names: Of the numbers of a state and of an action.
        left_out: Why verified sessions, or bags, are not among them: a reason, and how many.
        about: What the episodes are, in words.
    """

    target: str
    names: tuple[str, ...]
    fps: int
    episodes: tuple[Episode, ...]
    left_out: dict[str, int]
    about: str = "sessions whose verdict is success, on evidence"


def read_demonstrations(workspaces: Sequence[Path], choice: Choice) -> Demonstrations:
    """The verified sessions of workspaces, in the order of their submission.

    Raises:
        DefinitionError: `NOT_EXECUTED`, `INVALID_VALUE`, `UNKNOWN_NAME`; what
            `check_bundle` finds of a bundle that is not as it was recorded.
        ExecutionError: `JOURNAL_DAMAGED`, `EVIDENCE_DAMAGED`.
    """
    left_out: Counter[str] = Counter()
    found: dict[Path, SessionStatus] = {}
    forms: dict[tuple[str, ...], str] = {}  # target, names of its numbers -> a session of it
    get_profile = cache(get_registered_target)
    for workspace in map(Workspace.open, workspaces):
        for status in fold_partition(workspace.sessions / choose_partition(workspace.sessions)).sessions.values():
            bundle = workspace.evidence_of(status.contract.id)
            if status.state not in (_VERIFIED if choice.failures else {SessionState.SUCCEEDED}):
                continue
            if reason := _find_reason(bundle, status, choice):
                left_out[reason] += 1
                continue
            found[bundle] = status
            profile = get_profile(workspace.target_registry, status.contract.target)
            names = (*profile.arm.joints, *(("gripper",) if profile.gripper.max_width_m else ()))
            forms.setdefault((profile.target, *names), f"{status.contract.id} on {profile.target}")
    if not found:
        why = "; ".join(f"{count} with {reason}" for reason, count in left_out.items()) or "no session succeeded"
        where = ", ".join(map(str, workspaces))
        raise DefinitionError.of("NOT_EXECUTED", where, why, "sessions whose verdict is success")
    if len(forms) > 1:
        hint = "Choose one with --target, or name workspaces of one."
        raise DefinitionError.of("INVALID_VALUE", "--target", "; ".join(forms.values()), "sessions of one target", hint)
    problems = [problem for bundle in found for problem in check_bundle(bundle)]
    raise_any(problems)
    form, fps = next(iter(forms)), _choose_rate(next(iter(found)), choice.fps)
    read: list[Demonstration] = []
    for bundle, status in found.items():
        try:
            read.append(_read(bundle, status, choice, fps, len(form) - 1))
        except DefinitionError as error:
            problems += error.problems
    raise_any(problems)
    about = {"about": "sessions with a verdict on evidence"} if choice.failures else {}
    return Demonstrations(
        target=form[0], names=form[1:], fps=fps, episodes=tuple(read), left_out=dict(left_out), **about
    )


def _find_reason(bundle: Path, status: SessionStatus, choice: Choice) -> str:
    """Why a verified session is left out; empty where it is not."""
    if choice.skills and status.contract.skill not in choice.skills:
        return "another skill"
    if choice.target and status.contract.target != choice.target:
        return "another target"
    decided = status.decision
    if decided is None or decided.found not in {None, decided.verdict}:
        return "no verdict on evidence"
    reviews = (each for each in status.attempts if each.is_review)
    against = [each for each in reviews if (each.verdict is Verdict.SUCCESS) is decided.verdict.is_miss]
    if any(each.verifier != PERSON for each in against):
        return "a later judgement against it"
    if against and not choice.contested:
        return "a person who contests it"
    if not (bundle / TRAJECTORY).is_file():
        return "no trajectory: thinned, or gone"
    return "" if len(read_arrays(bundle / TRAJECTORY)["time_s"]) > 1 else "nothing commanded"


def _choose_rate(bundle: Path, fps: int) -> int:
    """The rate [Hz] at which set-points are due on the grid of the control periods."""
    control_hz = 1.0 / float(np.median(np.diff(read_arrays(bundle / TRAJECTORY)["time_s"])))
    periods = control_hz / (fps or round(control_hz))
    if periods < 1.0 - _TOLERANCE_S or abs(periods - round(periods)) > 1e-3:
        expected = f"{control_hz:g} divided by a whole number, as a whole number"
        raise DefinitionError.of("INVALID_VALUE", "--fps", str(fps or f"{control_hz:g}"), expected)
    return round(control_hz / round(periods))


def _read(bundle: Path, status: SessionStatus, choice: Choice, fps: int, width: int) -> Demonstration:
    """One session on the grid; where time went by without a command the set-point before it stood."""
    recorded = read_arrays(bundle / TRAJECTORY)
    time_s = recorded["time_s"]
    measured = np.column_stack((recorded["q_measured"], recorded["gripper_measured_m"]))
    commanded = np.column_stack((recorded["q_commanded"], recorded["gripper_commanded_m"]))
    n_steps = max(1, int((time_s[-1] - time_s[0]) * fps + _TOLERANCE_S))
    grid_s = time_s[0] + np.arange(n_steps + 1) / fps
    rows = np.searchsorted(time_s, grid_s + _TOLERANCE_S, side="right") - 1
    decided = status.decision
    assert decided is not None, "a session without a judgement is left out"
    return Demonstration(
        session=status.contract.id,
        bundle=bundle,
        skill=status.contract.skill,
        task=status.contract.objective,
        seed=status.contract.scene.seed,
        verdict=decided,
        led_by=status.execution.led_by if status.execution is not None else "",
        contested="; ".join(each.reason for each in status.attempts if each.verifier == PERSON),
        state=measured[rows[:-1], :width].astype(np.float32),
        action=commanded[rows[1:], :width].astype(np.float32),
        world=_read_world(bundle, [str(status.contract.parameters.get(name, name)) for name in choice.entities]),
        pictures=_read_pictures(bundle, choice.cameras, grid_s[:-1]),
    )


def _read_world(bundle: Path, entities: Collection[str]) -> Array:
    if not entities:
        return np.zeros(0, np.float32)
    known = msgspec.json.decode((bundle / BEFORE).read_bytes(), type=Environment).entities
    if unknown := [name for name in entities if name not in known]:
        raise DefinitionError([Problem.unknown("object", str(bundle / BEFORE), name, known) for name in unknown])
    poses = [known[name].pose for name in entities]
    return np.array([(*pose.position_m, *pose.quaternion_wxyz) for pose in poses], np.float32).ravel()


def _read_pictures(
    bundle: Path, cameras: Collection[str], grid_s: NDArray[np.float64]
) -> dict[str, tuple[RecordedPicture, ...]]:
    """For each camera the latest picture at each step; one that was late for the first step shows it as well."""
    if not cameras:
        return {}
    recording = read_recording(bundle)
    found: dict[str, list[RecordedPicture]] = {}
    for picture in recording.pictures if recording is not None else ():
        found.setdefault(picture.camera, []).append(picture)
    if unknown := [name for name in cameras if name not in found]:
        expected = f"a camera that was recorded: {format_names(found)}"
        hint = "`record:` of runtime_contract.yaml says which cameras sessions record."
        where = str(bundle / RECORDING)
        raise DefinitionError([Problem("UNKNOWN_NAME", where, name, expected, hint, kind="camera") for name in unknown])
    shown = {
        name: np.searchsorted([p.shown_s for p in found[name]], grid_s + _TOLERANCE_S, side="right") for name in cameras
    }
    return {name: tuple(found[name][max(0, after - 1)] for after in shown[name]) for name in cameras}
