"""`export lerobot`: verified sessions as training data."""

from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer

from phyagentos.cli.arguments import AsJson
from phyagentos.cli.outcome import print_found, print_note
from phyagentos.export.demonstrations import Choice, read_demonstrations
from phyagentos.export.lerobot import write_dataset

_SPACES = typer.Argument(metavar="WORKSPACE…", help="Workspaces whose sessions succeeded.")
_LIST = "Names with commas between."


def lerobot(
    workspaces: Annotated[list[Path], _SPACES],
    to: Annotated[Path, typer.Option("--to", metavar="DIR", help="A folder that is missing or empty.")],
    fps: Annotated[int, typer.Option(min=0, help="Frames a second; the control rate without.")] = 0,
    cameras: Annotated[str, typer.Option(help=f"Cameras that were recorded. {_LIST}")] = "",
    entities: Annotated[str, typer.Option(help=f"Things whose pose, as believed before, is data. {_LIST}")] = "",
    skill: Annotated[str, typer.Option(help=f"Only sessions of these skills. {_LIST}")] = "",
    target: Annotated[str, typer.Option(help="Only sessions of this target.")] = "",
    as_json: AsJson = False,
) -> None:
    """Write sessions whose verdict is success as a LeRobotDataset, format v3.0."""
    choice = Choice(skills=_split(skill), target=target, cameras=_split(cameras), entities=_split(entities), fps=fps)
    data = read_demonstrations(workspaces, choice)
    write_dataset(data, choice, to, version("phyagentos"))
    frames = sum(len(each.state) for each in data.episodes)
    for reason, count in () if as_json else data.left_out.items():
        print_note(f"left out: {count} ({reason})")
    facts = {"episodes": len(data.episodes), "frames": frames, "fps": data.fps, "left_out": data.left_out}
    print_found(facts, f"{to}: {len(data.episodes)} episodes, {frames} frames at {data.fps} Hz", as_json=as_json)


def _split(text: str) -> tuple[str, ...]:
    return tuple(filter(None, (name.strip() for name in text.split(","))))
