"""`paos robot`: profiles of robots: which there are, what one says and lacks, how it looks, a draft of a new one."""

import os
import re
from pathlib import Path
from typing import Annotated

import typer

from phyagentos.assembly.project import open_library
from phyagentos.cli.arguments import AsJson
from phyagentos.cli.outcome import ExitCode, print_found, print_json, print_note, print_result
from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.targets import is_beside
from phyagentos.protocol.documents.markdown import render_table
from phyagentos.protocol.settings.safety import Safety, read_safety

Name = Annotated[str, typer.Argument(metavar="ROBOT", help="Name of a target, as `paos robot list` prints it.")]


def list_(as_json: AsJson = False) -> None:
    """Print every profile that can be used here, with its model and whether that is here."""
    from phyagentos.runtime.models.robot import read_profile
    from phyagentos.runtime.models.sources import require_models

    rows = []
    library = open_library()
    for name in library.names_of_targets():
        missing = ""
        profile, folder = read_profile(library.get_target(name))
        try:
            require_models(profile, folder)
        except DefinitionError as error:
            missing = f"{error.problems[0].found}. {error.problems[0].hint}"
        rows.append((name, profile.kind, profile.embodiment, profile.model, missing or "here"))
    columns = ("robot", "kind", "embodiment", "model", "state")
    facts = [dict(zip(columns, row, strict=True)) for row in rows]
    print_found(facts, render_table(columns, rows), as_json=as_json)


def show(robot: Name, as_json: AsJson = False) -> None:
    """Print what a robot's model says: joints, ranges, hand, fingers, opening."""
    from phyagentos.runtime.models.robot import read_profile
    from phyagentos.runtime.motion.profile_checks import describe_robot
    from phyagentos.runtime.motion.robot_model import build_robot_model

    profile, folder = read_profile(open_library().get_target(robot))
    facts = {"robot": profile.target, "description": profile.description, "model": profile.model}
    facts |= describe_robot(build_robot_model(profile, folder)) if profile.model else {}
    print_found(facts, render_table(("", ""), list(facts.items())), as_json=as_json)


def check(robot: Name, as_json: AsJson = False) -> int:
    """Report all that a profile lacks before its robot can work, at file, line and column; exit code 2 with any."""
    from phyagentos.runtime.motion.profile_checks import check_profile

    library = open_library()
    path = library.get_target(robot)
    files = [root / "protocol" / "safety.yaml" for root in library.roots] + [path.with_name("safety.yaml")]
    found = [read_safety(each) for each in files if each.is_file()]
    limits = {name: limits for each in found for name, limits in each.targets.items()}
    problems = check_profile(path, Safety(targets=limits))
    if as_json:
        print_json([{"code": each.code, "address": each.address, "message": str(each)} for each in problems])
    else:
        for each in problems:
            print_result(str(each))
        print_note(f"{path}: {len(problems)} problems")
    return ExitCode.INVALID_INPUT if problems else ExitCode.GOAL_MET


def render(
    robot: Name,
    to: Annotated[Path, typer.Option("--to", metavar="FILE.png", help="Where the picture goes.")] = Path("robot.png"),
) -> None:
    """Draw a robot at home, with the frame of its tool: x red, y (closing) green, z (approach) blue."""
    os.environ.setdefault("MUJOCO_GL", "egl")  # read when MuJoCo is imported
    from phyagentos.assembly.robot_picture import draw_robot
    from phyagentos.runtime.models.robot import read_profile

    to.write_bytes(draw_robot(*read_profile(open_library().get_target(robot))))
    print_result(f"wrote {to}")


def new(
    model: Annotated[str, typer.Argument(metavar="MODEL", help="MJCF or URDF file, or SOURCE:PATH.")],
    name: Annotated[str, typer.Option("--name", help="Of the target; from the file's name by default.")] = "",
    folder: Annotated[Path, typer.Option("--in", metavar="DIR", help="Project that gets it.")] = Path(),
) -> None:
    """Draft a profile from a model: joints, limits, tool and fingers as it has them, or guessed and marked so."""
    from phyagentos.runtime.models.drafting import draft_profile
    from phyagentos.runtime.models.sources import find_model

    path = find_model(model, Path())
    if not path.is_file():
        raise DefinitionError.of("MODEL_MISSING", model, "no such file", "a MJCF or URDF file")
    target = name or re.sub(r"[^a-z0-9]+", "_", path.stem.lower()).strip("_") or "robot"
    place = folder / "robots" / target / "target.yaml"
    if place.exists():
        raise DefinitionError.of("WOULD_OVERWRITE", str(place), "a profile", "a new name", "Choose one with --name.")
    hint = f"models:{path.name}" if is_beside(model) else model
    text = draft_profile(path, hint, target)
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text(text)
    print_result(f"wrote {place}, {text.count('# check')} lines say check")
    if is_beside(model):
        print_note(f"its model is {hint}: set PHYAGENTOS_MODELS to {path.resolve().parent}")
    print_note(f"next: edit it, then paos robot check {target} && paos robot render {target}")
