"""Modules of the kits in the Python of ROS 2 or LeRobot, which is another one than this."""

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from phyagentos.cli.outcome import Exit, ExitCode, print_note

INSTALL = {
    "rclpy": "source ROS's setup.bash and `pip install --no-deps ./kits/{kit}` there",
    "lerobot": "`pip install ./kits/target_server[profile] ./kits/{kit}` there",
}


def become_node(python: str, kit: str, arguments: Sequence[str]) -> NoReturn:
    """Become the ROS 2 node of a kit, which calls this `paos`. Raises `Exit` as `find_python`."""
    found = find_python(python, "rclpy", kit)
    print_note(f"{kit} runs in {found}; Ctrl-C ends")
    paos = Path(sys.executable).with_name("paos")
    os.execv(found, [found, "-m", kit, *arguments, "--paos", str(paos)])


def run_module(python: str, package: str, module: str, arguments: Sequence[str]) -> None:
    """Run a module of a kit to its end. Raises `Exit` 2 as `find_python`, and with what it says where it fails."""
    found = find_python(python, package, module.partition(".")[0])
    done = subprocess.run([found, "-m", module, *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise Exit(ExitCode.INVALID_INPUT, _read_last_line(done.stderr))


def find_python(python: str, package: str, kit: str) -> str:
    """Where that Python is. Raises `Exit` 2 where there is none, or where it lacks the package or the kit."""
    found = shutil.which(python)
    if found is None:
        raise Exit(ExitCode.INVALID_INPUT, f"--python {python}: no such command. Name the Python that has {package}")
    done = subprocess.run([found, "-c", f"import {package}, {kit}"], capture_output=True, text=True, check=False)
    if done.returncode:
        where = f"{found} cannot import {package} and {kit}: {_read_last_line(done.stderr)}"
        how = INSTALL[package].format(kit=kit)
        raise Exit(ExitCode.INVALID_INPUT, f"{where}. {how}, or name that Python with --python")
    return found


def _read_last_line(said: str) -> str:
    return (said.strip().splitlines() or ["it cannot be started"])[-1]
