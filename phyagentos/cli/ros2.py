"""`paos ros2`: goals as an action, verdicts on topics: nodes of the kits in the Python of a ROS distribution."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from phyagentos.agent.tools.registry import Level
from phyagentos.cli.explaining import Space
from phyagentos.cli.kits import become_node

_PYTHON_HELP = "The Python of your ROS distribution, in whose environment the kit is installed."
_PERMIT_HELP = "A goal graph of the library that runs without a further decision; repeatable."
_POLICY_HELP = "At level submit: the file that decides, as for `paos approve`."
_TOPICS_HELP = "How the names of topics begin that are received; repeatable; all without."
_SETTINGS_HELP = "YAML: topics, frames and clocks, as for `paos verify --bag`."
Python = Annotated[str, typer.Option(help=_PYTHON_HELP, envvar="PHYAGENTOS_ROS2_PYTHON")]


def serve(
    workspace: Space,
    level: Annotated[Level, typer.Option(help="How far callers may go, as for `paos mcp`.")] = Level.READ,
    permit: Annotated[list[str] | None, typer.Option(metavar="GRAPH", help=_PERMIT_HELP)] = None,
    policy: Annotated[Path | None, typer.Option(help=_POLICY_HELP)] = None,
    waiting: Annotated[int, typer.Option(help="Goals that may wait for their turn.", min=0)] = 4,
    managed: Annotated[bool, typer.Option("--managed", help="Begin unconfigured, for a lifecycle manager.")] = False,
    python: Python = "python3",
) -> None:
    """Serve the goals of a workspace as a ROS 2 action, /phyagentos/run_goal, until Ctrl-C."""
    given = [str(workspace), "--level", str(level), "--waiting", str(waiting)]
    given += _repeat("--permit", permit) + _repeat("--policy", [policy] if policy else [])
    become_node(python, "ros2_goals", given + ["--managed"] * managed)


def watch(
    scene: Annotated[str, typer.Option(help="Of the library: the scene whose objects the cameras show.")],
    accept: Annotated[list[str], typer.Option(help="A criterion; repeatable.")],
    topics: Annotated[list[str] | None, typer.Option(metavar="PREFIX", help=_TOPICS_HELP)] = None,
    robot: Annotated[str, typer.Option(help="Of the library; by its joints without.")] = "",
    settings: Annotated[Path | None, typer.Option(help=_SETTINGS_HELP)] = None,
    every: Annotated[float, typer.Option(help="Seconds between verdicts; only on request without.", min=0.0)] = 0.0,
    to: Annotated[Path, typer.Option(help="Folder for evidence.")] = Path("verdicts"),
    python: Python = "python3",
) -> None:
    """Publish verdicts on what any ROS 2 robot did, as a node beside the programs that move it, until Ctrl-C."""
    given = ["--scene", scene, *_repeat("--accept", accept), "--every", str(every), "--to", str(to)]
    given += _repeat("--robot", [robot] if robot else []) + _repeat("--settings", [settings] if settings else [])
    become_node(python, "ros2_verdicts", given + (["--topics", *topics] if topics else []))


def _repeat(option: str, values: Iterable[object] | None) -> list[str]:
    return [part for each in values or () for part in (option, str(each))]
