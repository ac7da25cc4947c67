"""`paos robot`: profiles of robots: which there are, what one says and lacks, how it looks, a draft of a new one."""

from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import astuple

from phyagentos.cli.console import build_table
from phyagentos.cli.exporting import draw_without_screen
from phyagentos.cli.kits import run_module
from phyagentos.cli.outcome import ExitCode
from phyagentos.cli.reply import Reply
from phyagentos.errors import DefinitionError
from phyagentos.operations import robots
from phyagentos.operations.calibrate import CalibratedRobot, calibrate_robot
from phyagentos.operations.export import Written
from phyagentos.operations.lerobot import draft_lerobot
from phyagentos.operations.robots import DraftedProfile, KnownRobot, ProfileCheck, RobotDescription, RobotTrial
from phyagentos.operations.ros2 import DraftedSettings, draft_ros2
from phyagentos.wording import count

_FROM_HELP = "MODEL is written first: that of a running robot, by its /robot_description."
_TYPE_HELP = "FILE.yaml is written first, by LeRobot, which knows robots of this type; nothing is connected."
Name = Annotated[str, typer.Argument(metavar="ROBOT", help="Name of a target, as `paos robot list` prints it.")]


def list_() -> Reply[tuple[KnownRobot, ...]]:
    """Print every profile that can be used here, with its model and whether that is here."""
    found = robots.list_robots()
    return Reply(found, build_table(KnownRobot.__struct_fields__, map(astuple, found)))


def show(robot: Name) -> Reply[RobotDescription]:
    """Print what a robot's model says: joints, ranges, hand, fingers, opening."""
    found = robots.describe(robot)
    named = [("robot", found.robot), ("description", found.description), ("model", found.model)]
    return Reply(found, build_table(("", ""), [*named, *found.facts.items()]), found.remarks)


def check(robot: Name) -> Reply[ProfileCheck]:
    """Report all that a profile lacks before its robot can work, at file, line and column; exit code 2 with any."""
    found = robots.check_robot(robot)
    code = ExitCode.INVALID_INPUT if found.problems else ExitCode.GOAL_MET
    notes = [*found.remarks, f"{found.file}: {count(len(found.problems), 'problem')}"]
    return Reply(found, "\n".join(map(str, found.problems)), notes, code)


def render(
    robot: Name,
    to: Annotated[Path, typer.Option("--to", metavar="FILE.png", help="Where the picture goes.")] = Path("robot.png"),
) -> Reply[Written]:
    """Draw a robot at home, with the frame of its tool: x red, y (closing) green, z (approach) blue."""
    draw_without_screen()
    return Reply(robots.render_robot(robot, to), f"wrote {to}")


def try_(
    robot: Name,
    to: Annotated[Path, typer.Option("--to", metavar="FILE.png", help="Where the map goes.")] = Path("reach.png"),
    written: Annotated[bool, typer.Option("--write", help="Write what it measures into the profile.")] = False,
) -> Reply[RobotTrial]:
    """Try a robot alone in simulation: reach of grasps, opening, lag, returns, hold; exit code 1 if one is not well."""
    found = robots.try_robot(robot, to, is_written=written)
    rows = [(each.what, each.measured, "well" if each.well else "not well") for each in found.findings]
    notes = [f"wrote {to}", *(f"{each.what}: change {each.change}" for each in found.findings if each.change)]
    if not found.takes_m:
        notes.append(f"it has no hand that opens: no grasp was tried; write `gripper`, or: {found.with_hand}")
    entries = ", ".join(f"{key}: {value}" for key, value in found.entries.items())
    if entries and written:
        notes.append(f"wrote into its profile: {entries}")
    elif entries:
        notes.append(f"its profile has not yet: {entries}; write it by hand, or: paos robot try {robot} --write")
    is_well = all(each.well for each in found.findings)
    if is_well and found.takes_m >= robots.CUBE_M:
        notes.append(f"next: paos run tidy_table --set targets.arm={robot}")
    elif is_well and found.takes_m:
        notes.append(
            f"it takes what is at most {1e3 * found.takes_m:.0f} mm wide, and the cubes of tidy_table are wider; "
            f"next: smaller objects in a scene of yours (scenes/desk.yaml of `paos init`), or: {found.with_hand}"
        )
    elif not is_well:
        notes.append(f"next: change {found.file}, then: paos robot try {robot}")
    code = ExitCode.GOAL_MET if is_well else ExitCode.GOAL_NOT_MET
    return Reply(found, build_table(("", "measured", ""), rows), notes, code)


def ros2(robot: Name) -> Reply[DraftedSettings]:
    """Draft ros2.yaml beside a robot's profile, by which kits/ros2 finds its topics; what is guessed is marked."""
    return _show_draft(draft_ros2(robot), "ros2_body")


def lerobot(
    robot: Name,
    description: Annotated[Path, typer.Argument(metavar="FILE.yaml", help="What LeRobot says of the robot.")],
    kind: Annotated[str, typer.Option("--from", metavar="TYPE", help=_TYPE_HELP)] = "",
    fields: Annotated[
        list[str] | None, typer.Option("--field", metavar="NAME=VALUE", help="Of LeRobot's configuration; repeatable.")
    ] = None,
    python: Annotated[str, typer.Option(help="With --from: the Python of LeRobot.")] = "python3",
) -> Reply[DraftedSettings]:
    """Draft lerobot.yaml beside a robot's profile, by which kits/lerobot_robot serves it; what is guessed is marked."""
    if kind:
        run_module(python, "lerobot", "lerobot_robot.description", [str(description), kind, *(fields or ())])
    return _show_draft(draft_lerobot(robot, description), "lerobot_robot")


def _show_draft(found: DraftedSettings, kit: str) -> Reply[DraftedSettings]:
    notes = [f"next: python -m {kit} {found.file.with_name('target.yaml')} --port 7000 < KEY"]
    return Reply(
        found, "\n  ".join((f"wrote {found.file}; check {count(len(found.asks), 'line')}:", *found.asks)), notes
    )


def calibrate(robot: Name) -> Reply[CalibratedRobot]:
    """Calibrate a real robot by hand, step by step, and write what is measured into its profile."""

    def ask(request: str) -> None:
        typer.prompt(f"{request} Then press Enter", default="", show_default=False, err=True)

    found = calibrate_robot(robot, ask)
    rows = build_table(("setting", "measured"), [(name, str(each)) for name, each in found.settings.items()])
    return Reply(found, rows, [f"wrote {found.file}", f"next: paos robot check {robot}"])


def new(
    model: Annotated[str, typer.Argument(metavar="MODEL", help="MJCF or URDF file, or SOURCE:PATH.")],
    name: Annotated[str, typer.Option("--name", help="Of the target; from the file's name by default.")] = "",
    folder: Annotated[Path, typer.Option("--in", metavar="DIR", help="Project that gets it.")] = Path(),
    arguments: Annotated[
        list[str] | None,
        typer.Option("--arg", metavar="NAME=VALUE", help="An argument of a xacro file; may be given again."),
    ] = None,
    hand: Annotated[str, typer.Option("--hand", help="Model that its end carries, as SOURCE:PATH.")] = "",
    joint: Annotated[
        str, typer.Option("--joint", help="A joint of the arm to draft, where the model has several.")
    ] = "",
    running: Annotated[str, typer.Option("--from", metavar="ros2[:NAMESPACE]", help=_FROM_HELP)] = "",
    python: Annotated[str, typer.Option(help="With --from: the Python of your ROS.")] = "python3",
) -> Reply[DraftedProfile]:
    """Draft a profile from a model: joints, limits, tool and fingers as it has them, or guessed and marked so."""
    pairs = [text.partition("=") for text in arguments or ()]
    if wrong := [key for key, given, _ in pairs if not key or not given]:
        raise DefinitionError.of("INVALID_VALUE", "--arg", repr(wrong[0]), "NAME=VALUE")
    if running:
        kind, _, namespace = running.partition(":")
        if kind != "ros2":
            raise DefinitionError.of("INVALID_VALUE", "--from", repr(running), "ros2, or ros2:NAMESPACE")
        run_module(python, "rclpy", "ros2_body.description", [model, namespace])
    found = robots.draft_robot(model, folder, name, {key: value for key, _, value in pairs}, joint, hand)
    notes = [*found.remarks]
    notes += [f"its model is {found.model}: set PHYAGENTOS_MODELS to {found.models}"] if found.models else []
    if found.with_hand:
        notes.append(f"it has no hand that opens, so that it takes nothing; with one: {found.with_hand}")
    steps = ("check", "render", "try")
    notes.append(f"next: {' && '.join(f'paos robot {step} {found.robot}' for step in steps)} --write")
    written = f"wrote {found.file} and {found.safety.name}; check {count(len(found.asks), 'line')}:"
    return Reply(found, "\n  ".join((written, *found.asks)), notes)
