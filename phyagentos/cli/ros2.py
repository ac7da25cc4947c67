"""`paos ros2`: goals as an action, verdicts on topics: nodes of the kits in the Python of a ROS distribution."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from phyagentos.agent.tools.registry import Level
from phyagentos.cli.explaining import Space
from phyagentos.cli.outcome import Exit, ExitCode, print_note

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
    _become(python, "ros2_goals", given + ["--managed"] * managed)


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
    _become(python, "ros2_verdicts", given + (["--topics", *topics] if topics else []))


def _repeat(option: str, values: Iterable[object] | None) -> list[str]:
    return [part for each in values or () for part in (option, str(each))]


def _become(python: str, kit: str, arguments: list[str]) -> NoReturn:
    """Become the node of a kit, which calls this `paos`. Raises `Exit` 2 where that Python lacks ROS or the kit."""
    found = shutil.which(python)
    if found is None:
        raise Exit(ExitCode.INVALID_INPUT, f"--python {python}: no such command. Name the Python that has rclpy")
    done = subprocess.run([found, "-c", f"import rclpy, {kit}"], capture_output=True, text=True, check=False)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["it cannot be started"])[-1]
        where = f"{found} cannot import rclpy and {kit}: {last}"
        how = (
            f"source ROS's setup.bash and `pip install --no-deps ./kits/{kit}` there, or name that Python with --python"
        )
        raise Exit(ExitCode.INVALID_INPUT, f"{where}. {how}")
    print_note(f"{kit} runs in {found}; Ctrl-C ends")
    paos = Path(sys.executable).with_name("paos")
    os.execv(found, [found, "-m", kit, *arguments, "--paos", str(paos)])
