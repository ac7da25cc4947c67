"""`render`: a picture or a film of sessions, from their evidence alone."""

import os
from itertools import chain
from pathlib import Path
from typing import Annotated

import typer

from phyagentos.cli.explaining import Space
from phyagentos.cli.outcome import print_result
from phyagentos.errors import DefinitionError
from phyagentos.store.subjects import get_session

FILMS = (".webp", ".gif")
_IDS = typer.Argument(metavar="SESSION…", help="Session ids, the part after the goal is enough; a film shows all.")
_TO = typer.Option("--to", metavar="FILE", help="What is written: .png is a picture, .webp and .gif are films.")


def render(
    sessions: Annotated[list[str], _IDS],
    workspace: Space,
    to: Annotated[Path, _TO] = Path("session.png"),
    at: Annotated[
        float | None, typer.Option(help="Moment of a picture, seconds from the start; the end without.")
    ] = None,
    camera: Annotated[str, typer.Option(help="A camera of the scene; a view from the front without.")] = "",
    size: Annotated[tuple[int, int], typer.Option(metavar="WIDTH HEIGHT", help="In pixels.")] = (800, 600),
    fps: Annotated[int, typer.Option(min=1, max=60, help="Pictures a second of a film.")] = 12,
    speed: Annotated[float, typer.Option(min=0.1, help="Of a film, as a multiple of the robot's own.")] = 1.0,
    paths: Annotated[bool, typer.Option(help="Draw the tool's path, as planned and as measured.")] = True,
    beliefs: Annotated[bool, typer.Option(help="Draw outlines of things where they are believed to be.")] = True,
) -> None:
    """Draw any moment of a session, or a film of sessions, from evidence alone."""
    os.environ.setdefault("MUJOCO_GL", "egl")  # read when MuJoCo is imported
    from PIL import Image

    from phyagentos.operations.workspaces import read_ledger
    from phyagentos.pictures.playback import read_playback
    from phyagentos.pictures.scene import Look, SceneRenderer, iter_film, write_film
    from phyagentos.protocol.workspace.workspace import Workspace

    if to.suffix not in {".png", *FILMS}:
        expected = f".png, {', '.join(FILMS)}"
        raise DefinitionError.of("INVALID_VALUE", "--to", to.suffix, expected, "`paos export video` writes MP4.")
    place, known = Workspace.open(workspace), read_ledger(workspace).sessions
    shown = [read_playback(place, known[get_session(each, known)]) for each in sessions]
    look = Look(camera=camera, width=size[0], height=size[1], paths=paths, beliefs=beliefs)
    if to.suffix in FILMS:
        write_film(chain(*(iter_film(each, look, fps=fps, speed=speed) for each in shown)), to, fps)
    else:
        first_s, last_s = shown[-1].time_s[0], shown[-1].time_s[-1]
        with SceneRenderer(shown[-1], look) as renderer:
            Image.fromarray(renderer.draw(last_s if at is None else min(last_s, first_s + at))).save(to)
    print_result(f"wrote {to}")
