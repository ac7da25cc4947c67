"""`paos agent` that kills itself with SIGKILL at its n-th write to the journal: before it, in its middle, or after it.

    python dying_agent.py <graph> <workspace> <seed> <n> before|middle|after

After the write means before it was made durable and before anybody was told.
"""

import os
import signal
import sys
from pathlib import Path

from phyagentos.assembly.agent_plane import run_agent
from phyagentos.store.segments import SystemIO


def die_at(n: int, moment: str) -> None:
    """Arrange for the death."""
    write, count = SystemIO.write, 0

    def last_write(self: SystemIO, fd: int, data: bytes) -> int:
        nonlocal count
        count += 1
        if count != n:
            return write(self, fd, data)
        if moment != "before":
            part = len(data) if moment == "after" else len(data) // 2
            write(self, fd, bytes(data)[:part])
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError("nobody survives this")

    SystemIO.write = last_write


if __name__ == "__main__":
    graph, workspace, seed, n, moment = sys.argv[1:]
    die_at(int(n), moment)
    run_agent(Path(workspace), Path(graph), int(seed), goal=f"{Path(graph).stem}-{seed}")
