"""Processes of phyagentos beside a ROS node: without the node's libraries, and never longer than the node.

What ROS sets in an environment (libraries, packages of another Python) would break another Python, so children go
without. Between the node and a child stands a keeper, which ends the child with one SIGTERM when the node is gone: that
cancels the goal that the child pursues. (`PR_SET_PDEATHSIG` sends one for each thread of the node, and a second signal
ends `paos` before it has cancelled anything.)
"""

import os
import subprocess
import sys
from collections.abc import Sequence
from typing import IO, Any

_OF_ROS = ("LD_LIBRARY_PATH", "PYTHONPATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")
_KEEPER = """
import os, signal, subprocess, sys, threading

def end_with_the_node():
    os.read(0, 1)
    child.terminate()

child = subprocess.Popen(sys.argv[1:], stdin=subprocess.DEVNULL)
signal.signal(signal.SIGTERM, lambda *_: child.terminate())
threading.Thread(target=end_with_the_node, daemon=True).start()
sys.exit(child.wait())
"""


def make_environment() -> dict[str, str]:
    """The environment of this process without what ROS has put into it."""
    return {name: value for name, value in os.environ.items() if name not in _OF_ROS}


def start(command: Sequence[str], **pipes: IO[str] | int) -> "subprocess.Popen[str]":
    """Start a command that the end of its standard input ends; what a terminal sends to this process misses it."""
    given: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.DEVNULL, **pipes}
    return subprocess.Popen(command, env=make_environment(), encoding="utf-8", start_new_session=True, **given)


def start_kept(command: Sequence[str], **pipes: IO[str] | int) -> "subprocess.Popen[str]":
    """Start a command that reads no input, and ends with this process."""
    # -S: ROS wheels set their libraries again in any start of this Python with `site`
    return start([sys.executable, "-I", "-S", "-c", _KEEPER, *command], **pipes)


def end(process: "subprocess.Popen[str]", patience_s: float) -> None:
    """Request its end, and insist with a second signal."""
    for _ in range(2):
        process.terminate()
        try:
            process.wait(patience_s)
            return
        except subprocess.TimeoutExpired:
            continue
    process.kill()
