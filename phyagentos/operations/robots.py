"""Profiles of robots: which there are, what one's model says, what it lacks, how it looks, a draft of a new one."""

import math
import re
from collections.abc import Mapping
from pathlib import Path

import msgspec

from phyagentos.assembly.project import open_library, read_limits
from phyagentos.errors import DefinitionError, Problem, relocate
from phyagentos.operations.calibrate import write_entries
from phyagentos.operations.export import Written
from phyagentos.operations.ros2 import require_own
from phyagentos.protocol.capabilities.targets import is_beside
from phyagentos.protocol.documents.durable_files import replace_durably
from phyagentos.scratch import open_scratch

NEAR_M, FAR_M = 0.36, (0.66, 0.40)  # of what shipped scenes hold, the nearest, and the farthest along x and y
LEAST, STEP, SPARE = 0.5, 0.05, 0.2  # how small scenes become, by which steps; of a band, what is left free before it
SPARE_BEYOND = 0.05  # and at its end, where what is held is set down with more of the arm than it was taken
CUBE_M = 0.04  # of shipped scenes
HAND = "menagerie:robotiq_2f85/2f85.xml"


class KnownRobot(msgspec.Struct, frozen=True, kw_only=True):
    """A profile that can be used here; `state` is `here`, or what its model lacks."""

    robot: str
    kind: str
    embodiment: str
    model: str
    state: str


class RobotDescription(msgspec.Struct, frozen=True, kw_only=True):
    """What a profile and its model say; `facts` are joints, ranges, hand, fingers, opening, none without a model.

    `remarks` say what was left out of the model, or added to it.
    """

    robot: str
    description: str
    model: str
    facts: dict[str, str]
    remarks: tuple[str, ...] = ()


class ProfileCheck(msgspec.Struct, frozen=True, kw_only=True):
    """All that a profile lacks before its robot can work."""

    file: Path
    problems: tuple[Problem, ...]
    remarks: tuple[str, ...] = ()


class Measured(msgspec.Struct, frozen=True, kw_only=True):
    """One measurement of a trial; `well` where nothing of it would fail a session.

    `change` names what of the profile to change where it is not well.
    """

    what: str
    measured: str
    well: bool
    change: str = ""


class RobotTrial(msgspec.Struct, frozen=True, kw_only=True):
    """What a robot did alone in simulation; `band_m` is where it can take objects in front, none where it cannot.

    `takes_m` is how wide what its hand takes may be, zero without one that opens; `with_hand` is the command that
    drafts it with another; `entries` are what `file`, its profile, should say of this, as YAML.
    """

    robot: str
    file: Path
    findings: tuple[Measured, ...]
    band_m: tuple[float, float] | None
    picture: Path
    takes_m: float
    with_hand: str
    entries: dict[str, str] = {}


class DraftedProfile(msgspec.Struct, frozen=True, kw_only=True):
    """A profile and limits that were drafted: where, what is guessed, and the model that the profile names.

    Attributes:
        safety: Its limits.
        asks: Lines of both files that are guessed: file, line number and text.
        models: Folder that PHYAGENTOS_MODELS must name for this model; None where it is found without.
        remarks: What was left out of the model, or added to it.
        with_hand: The command that drafts it with a hand, where it has none that opens.
    """

    robot: str
    file: Path
    safety: Path
    asks: tuple[str, ...]
    model: str
    models: Path | None = None
    remarks: tuple[str, ...] = ()
    with_hand: str = ""


def list_robots() -> tuple[KnownRobot, ...]:
    """Every profile that can be used here."""
    from phyagentos.runtime.models.robot import read_profile
    from phyagentos.runtime.models.sources import require_models

    found, library = [], open_library()
    for name in library.names_of_targets():
        state = "here"
        profile, folder = read_profile(library.get_target(name))
        try:
            require_models(profile, folder)
        except DefinitionError as error:
            state = f"{error.problems[0].found}. {error.problems[0].hint}"
        facts = {"kind": profile.kind, "embodiment": profile.embodiment, "model": profile.model}
        found.append(KnownRobot(robot=name, state=state, **facts))
    return tuple(found)


def describe(robot: str) -> RobotDescription:
    """What a robot's model says; raises DefinitionError `UNKNOWN_NAME`, or of its model."""
    from phyagentos.runtime.models.robot import compile_robot, read_profile, read_remarks
    from phyagentos.runtime.motion.profile_checks import describe_robot
    from phyagentos.runtime.motion.robot_model import build_robot_model

    profile, folder = read_profile(open_library().get_target(robot))
    facts = {}
    if profile.model:
        compile_robot(profile, folder)  # physics needs masses, planning none
        facts = describe_robot(build_robot_model(profile, folder))
    names = {"robot": profile.target, "description": profile.description, "model": profile.model}
    return RobotDescription(**names, facts=facts, remarks=read_remarks(profile, folder))


def check_robot(robot: str) -> ProfileCheck:
    """Check a profile with the limits that hold for it here."""
    from phyagentos.runtime.models.robot import read_profile, read_remarks
    from phyagentos.runtime.motion.profile_checks import check_profile

    library = open_library()
    path = library.get_target(robot)
    problems = tuple(check_profile(path, read_limits(library, robot)))
    try:
        remarks = read_remarks(*read_profile(path))
    except DefinitionError:  # stands among the problems
        remarks = ()
    return ProfileCheck(file=path, problems=problems, remarks=remarks)


def render_robot(robot: str, to: Path) -> Written:
    """Draw a robot at home, with the frame of its tool; raises DefinitionError of its model, or `NO_GRAPHICS`."""
    from phyagentos.assembly.robot_picture import draw_robot
    from phyagentos.runtime.models.robot import read_profile

    to.write_bytes(draw_robot(*read_profile(open_library().get_target(robot))))
    return Written(file=to)


def try_robot(robot: str, to: Path, *, is_written: bool = False) -> RobotTrial:
    """Try a robot alone in simulation, and draw where its grasps reach; `is_written` into its profile too.

    Raises DefinitionError of profile or model, and `UNKNOWN_NAME` where a profile of the package should be written.
    """
    from phyagentos.assembly.robot_trial import run_trial
    from phyagentos.runtime.models.robot import read_profile
    from phyagentos.runtime.motion.grasps import LEAST_CLEARANCE_M

    if problems := (checked := check_robot(robot)).problems:
        raise DefinitionError(problems)
    if is_written:
        require_own(robot, checked.file.parent)
    profile, folder = read_profile(checked.file)
    trial = run_trial(profile, folder)
    to.write_bytes(trial.picture)
    findings = tuple(
        Measured(what=each.what, measured=each.measured, well=each.is_well, change="" if each.is_well else each.change)
        for each in trial.findings
    )
    entries = _list_entries(*trial.band_m) if trial.band_m is not None else {}
    if entries and is_written:
        text = checked.file.read_text(encoding="utf-8")
        replace_durably(checked.file, write_entries(text, entries).encode())
    return RobotTrial(
        robot=robot, file=checked.file, findings=findings, band_m=trial.band_m, picture=to, entries=entries,
        takes_m=max(profile.gripper.max_width_m - LEAST_CLEARANCE_M, 0.0),
        with_hand=_name_with_hand(
            checked.file.parent, profile.model, profile.arguments.as_texts(), profile.arm.joints[-1]
        ),
    )  # fmt: skip


def _name_with_hand(folder: Path, model: str, arguments: Mapping[str, str], joint: str) -> str:
    """The command that drafts a robot anew, with a hand that opens."""
    given = [f"--arg {key}={value}" for key, value in arguments.items()] + ([f"--joint {joint}"] if joint else [])
    return " ".join((f"rm -r {folder} && paos robot new {model} --name {folder.name} --hand {HAND}", *given))


def _list_entries(near_m: float, far_m: float) -> dict[str, str]:
    """What a profile says of distances [m] between which objects can be taken: these, and how scenes come so near."""
    scale = 1.0
    while True:  # trays become as small as what stands fixed, and hands do not: the largest scale that fits
        x, y = scale * FAR_M[0], scale * FAR_M[1]
        reach_m = far_m - SPARE_BEYOND * (far_m - near_m)
        nearer_m = min(math.sqrt(max(reach_m**2 - y**2, 0.0)) - x, 0.0)
        if scale <= LEAST or nearer_m == 0.0 or scale * NEAR_M + nearer_m >= near_m + SPARE * (far_m - near_m):
            break
        scale -= STEP
    placing = {"placement": f"{{scale: {scale:.2f}, move_m: [{nearer_m:.3f}, 0, 0]}}"}
    return {"grasp_band_m": f"[{near_m:.2f}, {far_m:.2f}]"} | (placing if (scale, nearer_m) != (1.0, 0.0) else {})


def draft_robot(
    model: str, folder: Path, name: str = "", arguments: Mapping[str, str] = {}, joint: str = "", hand: str = ""
) -> DraftedProfile:
    """Draft a profile from a model, named after its file without a name; what it does not say is guessed and marked.

    `arguments` are values of those of a xacro file; of several arms that with `joint` is drafted;
    `hand` is the model of one that it carries, as a profile here does.

    Raises DefinitionError `UNREADABLE_FILE`, `MODEL_INVALID`, `WOULD_OVERWRITE`, `INVALID_VALUE` for a name that no
    target can have, `IN_COLLISION` where no posture is free.
    """
    from phyagentos.runtime.models.drafting import draft_profile, find_carried
    from phyagentos.runtime.models.sources import find_model, look_in, name_in_models
    from phyagentos.runtime.motion.draft_settling import settle_draft

    path = find_model(model, Path())
    if not path.is_file():
        raise DefinitionError.of("UNREADABLE_FILE", model, "no such file", "a MJCF or URDF file")
    target = name or re.sub(r"^[^a-z]*", "", re.sub(r"[^a-z0-9]+", "_", path.stem.lower())).strip("_") or "robot"
    if not re.fullmatch(r"[a-z][a-z0-9_]*", target):
        raise DefinitionError.of("INVALID_VALUE", "--name", repr(target), "small letters, digits and _")
    place = folder / "robots" / target / "target.yaml"
    if place.exists():
        hint = f"Choose one with --name, or remove {place.parent} to draft it anew."
        raise DefinitionError.of("WOULD_OVERWRITE", str(place), "a profile", "a new name", hint)
    named, models = name_in_models(path) if is_beside(model) else (model, None)
    draft = draft_profile(path, named, target, arguments, joint, find_carried(hand, open_library()) if hand else None)
    with open_scratch() as aside, look_in(models):
        (trial := aside / "robots" / target / place.name).parent.mkdir(parents=True)
        try:
            draft, limits = settle_draft(draft, trial)
        except DefinitionError as error:
            raise DefinitionError(relocate(error.problems, aside)) from error
    texts, asks = {place: draft.render(), place.with_name("safety.yaml"): limits}, []
    place.parent.mkdir(parents=True, exist_ok=True)
    for file, text in texts.items():
        file.write_text(text, encoding="utf-8")
        asks += [f"{file.name}:{k}: {line.strip()}" for k, line in enumerate(text.splitlines(), 1) if "# check" in line]
    return DraftedProfile(
        robot=target, file=place, safety=place.with_name("safety.yaml"), asks=tuple(asks), model=named, models=models,
        remarks=draft.remarks,
        with_hand="" if draft.hand or draft.carried else _name_with_hand(place.parent, named, arguments, joint),
    )  # fmt: skip
