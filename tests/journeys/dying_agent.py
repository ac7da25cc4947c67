"""Forks agents, one at a time; each may kill itself with SIGKILL at its n-th write to the journal.

    python dying_agent.py <graph> <workspace>

For each line `<seed> <n> before|middle|after` it prints the process id of an agent, then its exit code. With n = 0 the
agent lives. After the write means before it was made durable and before anybody was told. A fork has imported what an
agent needs, and nothing else was done: it is a new agent, without half a second of imports.
"""

import os
import signal
import sys
import traceback
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


def serve(graph: Path, workspace: Path) -> None:
    """Until there is no line any more."""
    for line in sys.stdin:
        seed, n, moment = line.split()
        if (pid := os.fork()) == 0:
            os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
            code = 1
            try:
                die_at(int(n), moment)
                code = run_agent(workspace, graph, int(seed), goal=f"{graph.stem}-{seed}").exit_code
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(code)
        answer(pid)
        answer(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))


def answer(number: int) -> None:
    sys.stdout.write(f"{number}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    serve(*map(Path, sys.argv[1:]))
