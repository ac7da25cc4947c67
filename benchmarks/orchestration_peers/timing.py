"""What the runs of all peers share: arguments, scratch folder, the one line that they print."""

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from orchestration_shapes import build_edges


def note(log: str, index: int) -> None:
    """What a task does to the world where a run is killed and goes on: a line in a file, once for each execution."""
    file = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    os.write(file, b"%d\n" % index)
    os.close(file)


def measure(
    package: str,
    durable: str,
    workers: str,
    run: Callable[[list[list[int]], Path], int],
    recover: Callable[[int, str, Path], object] | None = None,
) -> None:
    """Time one run and print it as a line of JSON; as `recover N LOG SCRATCH`, carry on a chain that a death has cut.

    Args:
        package: Whose version is printed.
        durable: What is on the disk when a task counts as done.
        workers: How many work on it.
        run: Carries out a graph in a scratch folder, beginning with whatever is not timed; calls back nothing; returns
            how many tasks were done. It is called twice: with three tasks to warm up, then timed.
        recover: Begins a chain of tasks that `note` themselves in the file LOG, or goes on with the one in SCRATCH.
    """
    if sys.argv[1] == "recover" and recover is not None:
        recover(int(sys.argv[2]), sys.argv[3], Path(sys.argv[4]))
        return
    parser = argparse.ArgumentParser()
    parser.add_argument("shape", choices=("chain", "layered"))
    parser.add_argument("n", type=int)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="peer-", ignore_cleanup_errors=True) as scratch:
        run(build_edges("chain", 3), Path(scratch))
        edges = build_edges(given.shape, given.n)
        begin = time.perf_counter()
        done = run(edges, Path(scratch))
        seconds = time.perf_counter() - begin
        if done != given.n:
            sys.exit(f"{package}: {done} of {given.n} tasks were done")
        figures = {"seconds": seconds, "version": version(package), "durable": durable, "workers": workers}
        sys.stdout.write(json.dumps(figures) + "\n")
        sys.stdout.flush()
