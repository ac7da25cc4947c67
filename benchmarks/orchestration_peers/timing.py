"""What the runs of all peers share: arguments, scratch folder, the one line that they print."""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from orchestration_shapes import build_edges


def measure(package: str, durable: str, workers: str, run: Callable[[list[list[int]], Path], int]) -> None:
    """Time one run and print it as a line of JSON.

    Args:
        package: Whose version is printed.
        durable: What is on the disk when a task counts as done.
        workers: How many work on it.
        run: Carries out a graph in a scratch folder, beginning with whatever is not timed; calls back nothing; returns
            how many tasks were done. It is called twice: with three tasks to warm up, then timed.
    """
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
