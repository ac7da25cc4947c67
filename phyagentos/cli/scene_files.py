"""`paos scene`: how a scene looks, what is wrong with it, and a scene of what a run last saw."""

from pathlib import Path
from typing import Annotated

import typer

from phyagentos.assembly.project import get_file
from phyagentos.cli.arguments import choose_newest
from phyagentos.cli.exporting import draw_without_screen
from phyagentos.cli.outcome import ExitCode
from phyagentos.cli.reply import Reply, list_problems
from phyagentos.operations import scene_files
from phyagentos.operations.export import Written
from phyagentos.operations.scene_files import CheckedScene, SavedScene
from phyagentos.wording import count

Scene = Annotated[Path, typer.Argument(metavar="SCENE", help="A file, or a name of `paos list scenes`.")]
Robot = Annotated[str, typer.Option(help="A target; that of the scene's goal graphs by default.")]
Seed = Annotated[int, typer.Option(help="Of the scene's start.", min=0)]


def render(
    scene: Scene,
    to: Annotated[Path, typer.Option("--to", "-o", metavar="FILE.png", help="Where it goes.")] = Path("scene.png"),
    robot: Robot = "",
    camera: Annotated[str, typer.Option(help="A camera of the scene; a view from the front without.")] = "",
    seed: Seed = 0,
) -> Reply[Written]:
    """Draw a scene as it begins, with its robot at home and the names of its objects; run nothing."""
    draw_without_screen()
    return Reply(scene_files.render(get_file(scene, "scenes"), to, robot, camera, seed), f"wrote {to}")


def check(scene: Scene, robot: Robot = "", seed: Seed = 0) -> Reply[CheckedScene]:
    """Report what overlaps, floats, is out of reach or in view of no camera; exit code 2 with any."""
    found = scene_files.check(get_file(scene, "scenes"), robot, seed)
    problems = list_problems(found.problems)
    code = ExitCode.INVALID_INPUT if problems else ExitCode.GOAL_MET
    return Reply(
        found, f"{found.file}: {count(len(problems), 'problem')} with {found.robot or 'no robot'}", problems, code
    )


def save(
    name: Annotated[str, typer.Argument(help="Of the new scene.")],
    workspace: Annotated[Path | None, typer.Option("--workspace", "-w", help="Whose world; else the newest.")] = None,
    folder: Annotated[Path, typer.Option("--in", metavar="DIR", help="Project that gets it.")] = Path(),
) -> Reply[SavedScene]:
    """Write the world as a run last saw it as a scene file, in which another run begins."""
    found = scene_files.save(name, workspace or choose_newest(), folder)
    notes = [f"LEFT OUT {each}" for each in found.left_out]
    return Reply(found, f"wrote {found.file}", [*notes, f"next: paos scene check {found.file}"])
