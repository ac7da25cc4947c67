"""Processes of phyagentos beside a ROS node: without the node's libraries, and never longer than the node.

What ROS sets in an environment (libraries, packages of another Python) would break another Python, so children go
without. The kernel ends a child with SIGTERM when the node is gone, which cancels the goal that it pursues.
"""

import os
import subprocess
import sys
from collections.abc import Sequence
from typing import IO, Any

_OF_ROS = ("LD_LIBRARY_PATH", "PYTHONPATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")
# -S: ROS wheels set their libraries again in any start of this Python with `site`
_TIED = (
    "import ctypes, os, sys; ctypes.CDLL(None).prctl(1, 15)\n"  # PR_SET_PDEATHSIG, SIGTERM
    "os.getppid() == int(sys.argv[1]) or sys.exit(1)\n"
    "os.execvp(sys.argv[2], sys.argv[2:])"
)


def make_environment() -> dict[str, str]:
    """The environment of this process without what ROS has put into it."""
    return {name: value for name, value in os.environ.items() if name not in _OF_ROS}


def start(command: Sequence[str], **pipes: IO[bytes] | int | None) -> "subprocess.Popen[str]":
    """Start a command that ends with the thread which called this; it reads and writes UTF-8."""
    tied = [sys.executable, "-I", "-S", "-c", _TIED, str(os.getpid()), *command]
    given: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, **pipes}
    return subprocess.Popen(tied, env=make_environment(), encoding="utf-8", **given)


def end(process: "subprocess.Popen[str]", patience_s: float) -> None:
    """Request its end, and insist after a while."""
    process.terminate()
    try:
        process.wait(patience_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
