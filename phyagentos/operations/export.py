"""Sessions and goals as files for the tools of others: data sets, logs, films, pictures."""

from collections.abc import Sequence
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from phyagentos.assembly.project import open_library
from phyagentos.errors import DefinitionError
from phyagentos.operations.behaviour_trees import draw
from phyagentos.operations.workspaces import find_session, get_newest, read_ledger
from phyagentos.protocol.sessions.lifecycle import render_mermaid as render_lifecycle
from phyagentos.store.subjects import get_goal
from phyagentos.store.views.tasks import render_graph

if TYPE_CHECKING:
    from phyagentos.export.demonstrations import Choice, Demonstrations
    from phyagentos.pictures.scene import Look

FILMS = (".webp", ".gif")
MOMENT_S = 0.05  # a picture may be asked for that long after the last record
STATECHART = "statechart"


class Written(msgspec.Struct, frozen=True, kw_only=True):
    """A file that was written."""

    file: Path


class WrittenDataset(msgspec.Struct, frozen=True, kw_only=True):
    """A data set that was written, and how many sessions were left out, by reason."""

    folder: Path
    episodes: int
    frames: int
    fps: int
    left_out: dict[str, int]


class MermaidText(msgspec.Struct, frozen=True, kw_only=True):
    """A drawing as Mermaid; of a goal, with its workspace."""

    subject: str
    text: str
    workspace: Path | None = None


def export_dataset(
    workspaces: Sequence[Path],
    to: Path,
    *,
    fps: int = 0,
    cameras: Sequence[str] = (),
    entities: Sequence[str] = (),
    skills: Sequence[str] = (),
    target: str = "",
    contested: bool = False,
    failures: bool = False,
) -> WrittenDataset:
    """Write sessions whose verdict is success as a LeRobotDataset, format v3.0, at the control rate where `fps` is 0.

    With `contested` also those of which a person says otherwise, with `failures` also those that missed.

    Raises DefinitionError `EXTRA_MISSING`, `NOT_EXECUTED`, `INVALID_VALUE`, `WOULD_OVERWRITE`.
    """
    from phyagentos.export.demonstrations import Choice, read_demonstrations

    lists = {"skills": tuple(skills), "cameras": tuple(cameras), "entities": tuple(entities)}
    choice = Choice(target=target, fps=fps, contested=contested, failures=failures, **lists)
    return _write_dataset(read_demonstrations(workspaces, choice), choice, to)


def export_bag_dataset(
    bags: Sequence[Path],
    to: Path,
    task: str,
    *,
    fps: int = 0,
    cameras: Sequence[str] = (),
    robot: str = "",
    settings: Path | None = None,
    failures: bool = False,
) -> WrittenDataset:
    """Write bags of ROS 2 that others recorded as a LeRobotDataset, one episode each; raises as `read_bags`.

    With `failures` also those that `paos verify --bag` found to have missed; `WOULD_OVERWRITE`.
    """
    from phyagentos.export.demonstrations import Choice
    from phyagentos.operations.bag_dataset import read_bags

    choice = Choice(target=robot, fps=fps, cameras=tuple(cameras), failures=failures)
    return _write_dataset(read_bags(bags, choice, task, settings=settings), choice, to)


def _write_dataset(data: "Demonstrations", choice: "Choice", to: Path) -> WrittenDataset:
    from phyagentos.export.lerobot import write_dataset

    write_dataset(data, choice, to, version("phyagentos"))
    frames, left_out = sum(len(each.state) for each in data.episodes), dict(data.left_out)
    return WrittenDataset(folder=to, episodes=len(data.episodes), frames=frames, fps=data.fps, left_out=left_out)


def draw_mermaid(subject: str = "", root: Path | None = None) -> MermaidText:
    """A behaviour tree, the statechart of a session (`statechart`), or the graph of a goal as it stands, as Mermaid.

    A goal is that of the newest workspace without another; the only one without a name.
    """
    if subject == STATECHART:
        return MermaidText(subject=subject, text=render_lifecycle())
    if subject in open_library().names_of_trees() or Path(subject).suffix in {".yaml", ".yml"}:
        return MermaidText(subject=subject, text=draw(subject).mermaid)
    workspace = root or get_newest()[0]
    goal = get_goal(subject, str(workspace), read_ledger(workspace).goals)
    return MermaidText(subject=goal.id, text=render_graph(goal), workspace=workspace)


def export_mcap(root: Path, session: str, to: Path) -> Written:
    """Write a session as MCAP, for Foxglove and Lichtblick; raises DefinitionError `EXTRA_MISSING`."""
    from phyagentos.export.mcap_log import write_mcap

    write_mcap(*find_session(root, session), to)
    return Written(file=to)


def export_ros2_bag(root: Path, session: str, to: Path) -> Written:
    """Write a session as a bag of ROS 2, a folder; raises DefinitionError `EXTRA_MISSING`, `WOULD_OVERWRITE`."""
    from phyagentos.export.ros2_bag import write_ros2_bag

    write_ros2_bag(*find_session(root, session), to)
    return Written(file=to)


def export_rrd(root: Path, session: str, to: Path) -> Written:
    """Write a session for the viewer of Rerun; raises DefinitionError `EXTRA_MISSING`."""
    from phyagentos.export.rerun_view import write_rrd
    from phyagentos.pictures.playback import read_playback

    place, status = find_session(root, session)
    write_rrd(read_playback(place, status), status, to)
    return Written(file=to)


def export_video(root: Path, session: str, to: Path, *, camera: str = "", fps: int = 25) -> Written:
    """Write a film of a session as MP4, drawn from its evidence; raises DefinitionError `EXTRA_MISSING`."""
    from phyagentos.export.video import write_mp4
    from phyagentos.pictures.playback import read_playback
    from phyagentos.pictures.scene import Look, iter_film

    playback = read_playback(*find_session(root, session))
    write_mp4(iter_film(playback, Look(camera=camera), fps=fps), to, fps)
    return Written(file=to)


def render_sessions(
    root: Path, sessions: Sequence[str], to: Path, look: "Look", *, at_s: float | None = None, fps: int, speed: float
) -> Written:
    """Draw a moment of the last session, its end without `at_s` [s], or a film of all, by the suffix of the file.

    Raises DefinitionError `INVALID_VALUE`, `UNKNOWN_NAME`; what its evidence lacks.
    """
    from PIL import Image

    from phyagentos.pictures.playback import read_playback
    from phyagentos.pictures.scene import SceneRenderer, iter_film, write_film

    if to.suffix not in {".png", *FILMS}:
        expected = f".png, {', '.join(FILMS)}"
        raise DefinitionError.of("INVALID_VALUE", "--to", to.suffix, expected, "`paos export video` writes MP4.")
    shown = [read_playback(*find_session(root, each)) for each in sessions]
    if to.suffix in FILMS:
        write_film(chain(*(iter_film(each, look, fps=fps, speed=speed) for each in shown)), to, fps)
    else:
        first_s, last_s = shown[-1].time_s[0], shown[-1].time_s[-1]
        if at_s is not None and not 0.0 <= at_s <= last_s - first_s + MOMENT_S:
            expected = f"0 to {last_s - first_s:.2f} s, as long as session {sessions[-1]!r} is recorded"
            raise DefinitionError.of("INVALID_VALUE", "--at", f"{at_s:g} s", expected, "Leave it out for the end.")
        with SceneRenderer(shown[-1], look) as renderer:
            Image.fromarray(renderer.draw(last_s if at_s is None else min(last_s, first_s + at_s))).save(to)
    return Written(file=to)
