"""Processes that are killed, stopped, or find the disk full: the goal still ends, and nothing happens twice."""

import contextlib
import json
import os
import signal
from pathlib import Path

import pytest
import yaml

from benchmarks import chaos
from benchmarks.chaos_planes import Planes, allow_writes, fill, find_processes, refuse_writes, small_disk
from phyagentos.clock import SystemClock
from phyagentos.operations.evidence import check_evidence
from phyagentos.protocol.sessions.evidence_manifest import iter_bundles, list_unsealed
from phyagentos.protocol.sessions.heartbeats import find_heartbeat
from tests.following import wait_until

TIDY_TABLE = Path(__file__).resolve().parents[2] / "goal_graphs" / "tidy_table.yaml"
LIMIT_S = 200.0

pytestmark = [pytest.mark.journey, pytest.mark.usefixtures("starts_interpreters")]


CUBES = chaos.CUBES[:2]  # red and green


@pytest.fixture
def make_planes(tmp_path):
    """Planes at `tidy_table` with some of its cubes; at the end no process of theirs is left."""
    made = []

    def make(cubes=CUBES):
        colours = [cube.partition("_")[0] for cube, _ in cubes]
        data = yaml.safe_load(TIDY_TABLE.read_text())
        data["sessions"] = {colour: data["sessions"][colour] for colour in colours}
        data["accept"] = [text for text in data["accept"] if any(colour in text for colour in colours)]
        (graph := tmp_path / "tidy_table.yaml").write_text(yaml.safe_dump(data))
        made.append(Planes(tmp_path / "w", graph, 1, SystemClock()))
        return made[-1]

    yield make
    assert [planes.stop() for planes in made] == [[]]


def tend_until(planes, is_so) -> None:
    def has_come() -> bool:
        planes.tend()
        return is_so()

    wait_until(has_come, limit_s=LIMIT_S)


def is_moving(planes) -> bool:
    beat = find_heartbeat(planes.root / "heartbeats", "panda")
    return beat is not None and beat.phase == "executing" and beat.tick > 30


def count_worlds(planes) -> int:
    lines = (planes.root / "logs" / "receive-panda.jsonl").read_text().splitlines()
    return sum(json.loads(line)["kind"] == "process_start" for line in lines)


def check_bundles(planes, cubes) -> None:
    """Once the planes have ended, no promise is broken; what was carried out has its bundle, and each is sealed."""
    assert planes.stop() == []
    goal, sessions = planes.read_goal()
    assert goal.verdict == "success"
    case = chaos.Case(number=1, victim="", attack="", mode="lockstep", delay_s=0.0)
    chaos.judge(case, goal, sessions)
    chaos.judge_world(case, planes.root, sessions, cubes)
    chaos.judge_log(case, planes.root)
    assert (case.notes, case.commands > 50) == ([], True)
    assert check_evidence(planes.root).problems == ()
    bundles = {folder.name for folder in iter_bundles(planes.root / "evidence")}
    assert bundles == {status.contract.id for status in sessions if status.execution is not None}


def test_a_world_that_is_killed_costs_at_most_its_session_and_all_processes_no_bundle(make_planes):
    """All at once in a later session, while the worker is too busy to have sealed the bundle before."""
    planes = make_planes()
    tend_until(planes, lambda: is_moving(planes))
    os.kill(planes.find("world"), signal.SIGKILL)
    tend_until(planes, lambda: len(list_unsealed(planes.root / "evidence")) > 1 and is_moving(planes))
    goal, sessions = planes.read_goal()
    assert goal.replans <= 1
    assert (planes.restarts["watchdog"], count_worlds(planes)) == (0, 2)
    assert "target_lost" in {status.execution.ended for status in sessions if status.execution is not None}

    for pid in find_processes(planes.root):
        with contextlib.suppress(ProcessLookupError):  # it ended with its parent
            os.kill(pid, signal.SIGKILL)
    tend_until(planes, planes.tend)

    assert planes.restarts == {"watchdog": 1, "agent": 1}
    check_bundles(planes, CUBES)


def test_every_bundle_is_sealed_after_the_disk_was_full(tmp_path, make_planes):
    """Where no file system can be mounted, no process that is there may write instead."""
    with small_disk(tmp_path, chaos.DISK_MB) as has_disk:
        planes = make_planes(CUBES[:1])
        try:
            tend_until(planes, lambda: is_moving(planes))
            ballast = fill(tmp_path) if has_disk else tmp_path / "none"
            for pid in [] if has_disk else find_processes(planes.root):
                refuse_writes(pid)
            chaos.wait(planes, chaos.FULL_S, SystemClock())
            ballast.unlink(missing_ok=True)
            allow_writes(planes.root)
            tend_until(planes, planes.tend)
            check_bundles(planes, CUBES[:1])
        finally:
            planes.stop()
