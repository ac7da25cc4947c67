"""`export`: verified sessions as training data, one session as a log, drawings as Mermaid."""

import os
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer

from phyagentos.assembly.project import open_library
from phyagentos.cli.arguments import AsJson, choose_newest
from phyagentos.cli.explaining import Id, Space, show_graph
from phyagentos.cli.outcome import print_found, print_note, print_result
from phyagentos.cli.showing import show_lifecycle
from phyagentos.cli.tree_drawing import show as show_tree
from phyagentos.cli.tree_exchange import bt_xml as bt_xml  # noqa: PLC0414 - one of the group
from phyagentos.errors import DefinitionError
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.sessions.session import SessionStatus
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.subjects import get_session

_SPACES = typer.Argument(metavar="WORKSPACE…", help="Workspaces whose sessions succeeded.")
_LIST = "Names with commas between."
_TO = typer.Option("--to", metavar="FILE", help="The file that is written.")


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
    from phyagentos.export.demonstrations import Choice, read_demonstrations
    from phyagentos.export.lerobot import write_dataset

    choice = Choice(skills=_split(skill), target=target, cameras=_split(cameras), entities=_split(entities), fps=fps)
    data = read_demonstrations(workspaces, choice)
    write_dataset(data, choice, to, version("phyagentos"))
    frames = sum(len(each.state) for each in data.episodes)
    for reason, count in () if as_json else data.left_out.items():
        print_note(f"left out: {count} ({reason})")
    facts = {"episodes": len(data.episodes), "frames": frames, "fps": data.fps, "left_out": data.left_out}
    print_found(facts, f"{to}: {len(data.episodes)} episodes, {frames} frames at {data.fps} Hz", as_json=as_json)


def mermaid(
    subject: Annotated[str, typer.Argument(help="A tree, `statechart`, or a goal; the only goal without.")] = "",
    workspace: Annotated[Path | None, typer.Option("--workspace", "-w", help="Of the goal; else the newest.")] = None,
) -> None:
    """Print a behaviour tree, the statechart of a session, or the graph of a goal as it stands, as Mermaid."""
    if subject == "statechart":
        show_lifecycle(mermaid=True)
    elif subject in open_library().names_of_trees() or Path(subject).suffix in {".yaml", ".yml"}:
        show_tree(subject, mermaid=True)
    else:
        show_graph(workspace or choose_newest(), subject, mermaid=True).print(as_json=False)


def html(
    workspace: Space,
    goal: Annotated[str, typer.Argument(help="Its id; the latest one without.")] = "",
    to: Annotated[Path, _TO] = Path("goal.html"),
) -> None:
    """Write a goal as one HTML file that opens without a server: graph, sessions, trees, pictures, verdicts."""
    from phyagentos.view.archive import build_archive
    from phyagentos.view.documents import Documents

    documents = Documents(workspace)
    documents.refresh()
    status = documents.find_goal(goal)
    if status is None:
        raise DefinitionError.unknown("UNKNOWN_GOAL", str(workspace), goal, documents.ledger.goals)
    to.write_text(build_archive(documents, status), encoding="utf-8")
    print_result(f"wrote {to}")


def mcap(session: Id, workspace: Space, to: Annotated[Path, _TO] = Path("session.mcap")) -> None:
    """Write a session as MCAP, for Foxglove and Lichtblick: motion, tree, statechart, pictures, documents."""
    from phyagentos.export.mcap_log import write_mcap

    write_mcap(*_find_session(workspace, session), to)
    print_result(f"wrote {to}")


def rrd(session: Id, workspace: Space, to: Annotated[Path, _TO] = Path("session.rrd")) -> None:
    """Write a session for the viewer of Rerun: the bodies of its scene over time, the tree and the criteria."""
    from phyagentos.export.rerun_view import write_rrd
    from phyagentos.pictures.playback import read_playback

    place, status = _find_session(workspace, session)
    write_rrd(read_playback(place, status), status, to)
    print_result(f"wrote {to}")


def video(
    session: Id,
    workspace: Space,
    to: Annotated[Path, _TO] = Path("session.mp4"),
    camera: Annotated[str, typer.Option(help="A camera of the scene; a view from the front without.")] = "",
    fps: Annotated[int, typer.Option(min=1, max=60, help="Pictures a second.")] = 25,
) -> None:
    """Write a film of a session as MP4, drawn from its evidence as `paos render` draws it."""
    os.environ.setdefault("MUJOCO_GL", "egl")  # read when MuJoCo is imported
    from phyagentos.export.video import write_mp4
    from phyagentos.pictures.playback import read_playback
    from phyagentos.pictures.scene import Look, iter_film

    playback = read_playback(*_find_session(workspace, session))
    write_mp4(iter_film(playback, Look(camera=camera), fps=fps), to, fps)
    print_result(f"wrote {to}")


def _find_session(root: Path, text: str) -> tuple[Workspace, SessionStatus]:
    known = read_ledger(root, text).sessions
    return Workspace.open(root), known[get_session(text, known)]


def _split(text: str) -> tuple[str, ...]:
    return tuple(filter(None, (name.strip() for name in text.split(","))))
