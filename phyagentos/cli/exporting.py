"""Files for the tools of others: `export`, and `import` of trees; `render` draws sessions."""

from pathlib import Path
from typing import Annotated

import typer

from phyagentos.cli.arguments import RunPython
from phyagentos.cli.explaining import Id, Space
from phyagentos.cli.reply import Reply
from phyagentos.errors import DefinitionError
from phyagentos.operations import behaviour_trees, export
from phyagentos.operations.behaviour_trees import ExportedTree, ImportedTrees
from phyagentos.operations.export import MermaidText, Written, WrittenDataset

_SPACES = typer.Argument(metavar="WORKSPACE…", help="Workspaces whose sessions succeeded.")
_FROM_BAG = "A recorded bag of ROS 2 as an episode, of any robot; repeatable."
_LIST = "Names with commas between."
_IDS = typer.Argument(metavar="SESSION…", help="Session ids, the part after the goal is enough; a film shows all.")
_TO = typer.Option("--to", metavar="FILE", help="The file that is written.")
_LOG = typer.Option("--to", metavar="FILE", help="The file, or folder of a bag.", show_default="session.mcap")
_DRAWN = typer.Option("--to", metavar="FILE", help="What is written: .png is a picture, .webp and .gif are films.")


def lerobot(
    to: Annotated[Path, typer.Option("--to", metavar="DIR", help="A folder that is missing or empty.")],
    workspaces: Annotated[list[Path] | None, _SPACES] = None,
    fps: Annotated[int, typer.Option(min=0, help="Frames a second; the control rate without.")] = 0,
    cameras: Annotated[str, typer.Option(help=f"Cameras that were recorded. {_LIST}")] = "",
    entities: Annotated[str, typer.Option(help=f"Objects whose pose, as believed before, is data. {_LIST}")] = "",
    skill: Annotated[str, typer.Option(help=f"Only sessions of these skills. {_LIST}")] = "",
    target: Annotated[str, typer.Option(help="Only sessions of this target; the robot of bags.")] = "",
    contested: Annotated[bool, typer.Option("--contested", help="Also verdicts that a person contests.")] = False,
    failures: Annotated[
        bool, typer.Option("--failures", help="Also sessions that missed; verdict and cause say so.")
    ] = False,
    from_bag: Annotated[list[Path] | None, typer.Option("--from-bag", metavar="BAG", help=_FROM_BAG)] = None,
    task: Annotated[str, typer.Option(help="Of bags: what they show, in words.")] = "",
    settings: Annotated[Path | None, typer.Option(help="YAML: topics, frames and clocks of bags.")] = None,
) -> Reply[WrittenDataset]:
    """Write sessions whose verdict is success, or bags of ROS 2, as a LeRobotDataset, format v3.0."""
    lists = {"cameras": _split(cameras), "entities": _split(entities), "skills": _split(skill)}
    if bool(from_bag) == bool(workspaces) or bool(from_bag) != bool(task):
        expected = "workspaces, or --from-bag with --task"
        raise DefinitionError.of("INVALID_VALUE", "paos export lerobot", "both, none, or a part", expected)
    if from_bag:
        if skill or entities or contested:
            of_bags = "--target, --cameras, --fps, --failures, --task, --settings"
            raise DefinitionError.of("INVALID_VALUE", "--from-bag", "options of sessions besides", of_bags)
        found = export.export_bag_dataset(
            from_bag, to, task, fps=fps, cameras=lists["cameras"], robot=target, settings=settings, failures=failures
        )
    else:
        found = export.export_dataset(
            workspaces or (), to, fps=fps, target=target, contested=contested, failures=failures, **lists
        )
    left_out = [f"left out: {count} ({reason})" for reason, count in found.left_out.items()]
    return Reply(found, f"{to}: {found.episodes} episodes, {found.frames} frames at {found.fps} Hz", left_out)


def mermaid(
    subject: Annotated[str, typer.Argument(help="A tree, `statechart`, or a goal; the only goal without.")] = "",
    workspace: Annotated[Path | None, typer.Option("--workspace", "-w", help="Of the goal; else the newest.")] = None,
) -> Reply[MermaidText]:
    """Print a behaviour tree, the statechart of a session, or the graph of a goal as it stands, as Mermaid."""
    found = export.draw_mermaid(subject, workspace)
    is_chosen = workspace is None and found.workspace is not None
    return Reply(found, found.text, [f"workspace {found.workspace} (the newest)"] if is_chosen else [], folds=False)


def bt_xml(
    tree: Annotated[str, typer.Argument(help="Name of a tree or of a skill, or the YAML file of a tree.")],
    run_python: RunPython = False,
) -> Reply[ExportedTree]:
    """Print a behaviour tree and its subtrees as XML of BehaviorTree.CPP 4, with a model of every leaf."""
    found = behaviour_trees.export_bt_xml(tree, runs_python=run_python)
    return Reply(found, found.xml)


def import_tree(
    file: Annotated[Path, typer.Argument(metavar="TREE.xml", help="A file of BehaviorTree.CPP 4.")],
    to: Annotated[Path, typer.Option("--to", metavar="DIR", help="A project: its trees/ gets what is new.")] = Path(),
    run_python: RunPython = False,
) -> Reply[ImportedTrees]:
    """Write the behaviour trees of a file that Groot2 saved as YAML."""
    found = behaviour_trees.import_trees(file, to, runs_python=run_python)
    return Reply(found, "\n".join(map(str, found.files)) or "every tree of the file is in the library already")


def html(
    workspace: Space,
    goal: Annotated[str, typer.Argument(help="Its id; the latest one without.")] = "",
    to: Annotated[Path, _TO] = Path("goal.html"),
) -> Reply[Written]:
    """Write a goal as one HTML file that opens without a server: graph, sessions, trees, pictures, verdicts."""
    from phyagentos.view.archive import write_archive

    return _tell(write_archive(workspace, goal, to))


def mcap(
    session: Id,
    workspace: Space,
    to: Annotated[Path | None, _LOG] = None,
    ros2: Annotated[bool, typer.Option("--ros2", help="A bag of ROS 2, a folder, for `ros2 bag play`.")] = False,
) -> Reply[Written]:
    """Write a session as MCAP, for Foxglove and Lichtblick: motion, tree, statechart, pictures, documents."""
    if ros2:
        return _tell(export.export_ros2_bag(workspace, session, to or Path("session_bag")))
    return _tell(export.export_mcap(workspace, session, to or Path("session.mcap")))


def rrd(session: Id, workspace: Space, to: Annotated[Path, _TO] = Path("session.rrd")) -> Reply[Written]:
    """Write a session for the viewer of Rerun: the bodies of its scene over time, the tree and the criteria."""
    return _tell(export.export_rrd(workspace, session, to))


def video(
    session: Id,
    workspace: Space,
    to: Annotated[Path, _TO] = Path("session.mp4"),
    camera: Annotated[str, typer.Option(help="A camera of the scene; a view from the front without.")] = "",
    fps: Annotated[int, typer.Option(min=1, max=60, help="Pictures a second.")] = 25,
) -> Reply[Written]:
    """Write a film of a session as MP4, drawn from its evidence as `paos render` draws it."""
    draw_without_screen()
    return _tell(export.export_video(workspace, session, to, camera=camera, fps=fps))


def render(
    sessions: Annotated[list[str], _IDS],
    workspace: Space,
    to: Annotated[Path, _DRAWN] = Path("session.png"),
    at: Annotated[
        float | None, typer.Option(help="Moment of a picture, seconds from the start; the end without.")
    ] = None,
    camera: Annotated[str, typer.Option(help="A camera of the scene; a view from the front without.")] = "",
    size: Annotated[tuple[int, int], typer.Option(metavar="WIDTH HEIGHT", help="In pixels.")] = (800, 600),
    fps: Annotated[int, typer.Option(min=1, max=60, help="Pictures a second of a film.")] = 12,
    speed: Annotated[float, typer.Option(min=0.1, help="Of a film, as a multiple of the robot's own.")] = 1.0,
    paths: Annotated[bool, typer.Option(help="Draw the tool's path, as planned and as measured.")] = True,
    beliefs: Annotated[bool, typer.Option(help="Draw outlines of objects where they are believed to be.")] = True,
) -> Reply[Written]:
    """Draw any moment of a session, or a film of sessions, from evidence alone."""
    draw_without_screen()
    from phyagentos.pictures.scene import Look

    look = Look(camera=camera, width=size[0], height=size[1], paths=paths, beliefs=beliefs)
    return _tell(export.render_sessions(workspace, sessions, to, look, at_s=at, fps=fps, speed=speed))


def draw_without_screen() -> None:
    """Let MuJoCo draw without a display, unless the environment says how; raises as `require_graphics`."""
    from phyagentos.assembly.graphics import choose_graphics, require_graphics

    require_graphics()
    choose_graphics()


def _tell(found: Written) -> Reply[Written]:
    return Reply(found, f"wrote {found.file}")


def _split(text: str) -> tuple[str, ...]:
    return tuple(filter(None, (name.strip() for name in text.split(","))))
