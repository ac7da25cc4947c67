"""The rehearsal process of one target: `python -m phyagentos.assembly.rehearsal ...`; started by its worker."""

import argparse
import os
import sys
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path

from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.workspace.workspace import Workspace


def make_command(root: Path, target: str) -> list[str]:
    """What a worker starts."""
    return [sys.executable, "-m", "phyagentos.assembly.rehearsal", "--workspace", str(root), "--target", target]


def run_rehearsal(root: Path, target: str, descriptor: int) -> None:
    """Answer the worker until it is gone."""
    from phyagentos.runtime.execution.leaf_registry import build_registry
    from phyagentos.runtime.lookahead.forecast import Forecaster
    from phyagentos.runtime.lookahead.process import serve
    from phyagentos.runtime.lookahead.rehearsal import Rehearser
    from phyagentos.runtime.models.robot import read_profile
    from phyagentos.runtime.motion.planner import MotionPlanner
    from phyagentos.runtime.motion.process import LocalPlanner
    from phyagentos.runtime.preflight.settings import read_settings
    from phyagentos.runtime.supervision.workers import end_with_parent

    end_with_parent()
    workspace = Workspace.open(root)
    library = workspace.library()
    path = library.get_target(target)
    profile, folder = read_profile(path)
    planner = MotionPlanner.open(path)
    planner.warm_up()
    rehearser = Rehearser(
        profile=profile,
        folder=folder,
        limits=read_settings(workspace, target).limits,
        library=library,
        registry=build_registry(library),
        planner=LocalPlanner(planner),
        clock=SystemClock(),
    )
    forecaster = Forecaster(rehearser=rehearser, threads=len(os.sched_getaffinity(0)))
    serve(forecaster, Connection(descriptor))


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of the process."""
    parser = argparse.ArgumentParser(prog="phyagentos.assembly.rehearsal")
    parser.add_argument("--workspace", type=Path, required=True)
    parser.add_argument("--target", required=True)
    parser.add_argument("--descriptor", type=int, required=True)
    given = parser.parse_args(argv)
    try:
        run_rehearsal(given.workspace, given.target, given.descriptor)
    except DefinitionError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
