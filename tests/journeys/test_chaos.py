"""Processes that are killed, stopped, or find the disk full: the goal still ends, and nothing happens twice."""

import contextlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.evidence_manifest import iter_bundles, list_unsealed
from phyagentos.protocol.sessions.heartbeats import find_heartbeat
from tests.following import wait_until

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))

import chaos  # noqa: E402 - lies with the benchmark
from chaos_planes import Planes, allow_writes, fill, find_processes, refuse_writes, small_disk  # noqa: E402

TIDY_TABLE = Path(__file__).resolve().parents[2] / "goal_graphs" / "tidy_table.yaml"
LIMIT_S = 200.0

pytestmark = pytest.mark.journey


@pytest.fixture
def graph(tmp_path_factory):
    """`tidy_table` with two of its three cubes; beside the folder on which a disk is mounted."""
    data = yaml.safe_load(TIDY_TABLE.read_text())
    del data["sessions"]["blue"]
    data["accept"] = [text for text in data["accept"] if "blue" not in text]
    path = tmp_path_factory.mktemp("graph") / "tidy_table.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


@pytest.fixture
def planes(tmp_path, graph):
    planes = Planes(tmp_path / "w", graph, 1, SystemClock())
    yield planes
    assert planes.stop() == []


def tend_until(planes, is_so) -> None:
    def has_come() -> bool:
        planes.tend()
        return is_so()

    wait_until(has_come, limit_s=LIMIT_S)


def is_moving(planes) -> bool:
    beat = find_heartbeat(planes.root / "heartbeats", "panda")
    return beat is not None and beat.phase == "executing" and beat.tick > 30


def kill(planes, name: str) -> None:
    tend_until(planes, lambda: is_moving(planes))
    os.kill(planes.find(name), signal.SIGKILL)


def count_worlds(planes) -> int:
    lines = (planes.root / "logs" / "receive-panda.jsonl").read_text().splitlines()
    return sum(json.loads(line)["kind"] == "process_start" for line in lines)


def find_broken_promises(planes) -> list[str]:
    """What the benchmark finds in a workspace whose goal is over."""
    goal, sessions = planes.read_goal()
    case = chaos.Case(1, "", "", "lockstep", 0.0)
    chaos.judge(case, goal, sessions)
    chaos.judge_world(case, planes.root, sessions, chaos.CUBES[:2])
    chaos.judge_log(case, planes.root)
    assert case.commands > 100
    return case.notes


def check_bundles(planes) -> None:
    """Once the planes have ended, every session that was carried out has its bundle, and each is sealed."""
    assert planes.stop() == []
    goal, sessions = planes.read_goal()
    command = [sys.executable, "-m", "phyagentos", "evidence", "verify", "--json", "--workspace", str(planes.root)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)

    assert goal.verdict == "success"
    assert find_broken_promises(planes) == []
    assert (done.returncode, json.loads(done.stdout)["problems"]) == (0, []), done.stdout
    bundles = {folder.name for folder in iter_bundles(planes.root / "evidence")}
    assert bundles == {status.contract.id for status in sessions if status.execution is not None}


def test_every_promise_is_kept_when_a_planner_dies():
    """The attack that no other journey makes: worker and agent die in theirs, all others below."""
    command = [sys.executable, str(BENCHMARKS / "chaos.py"), "--runs", "1", "--mode", "lockstep"]
    command += ["--only", "planner"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=550, check=False)

    assert done.returncode == 0, done.stdout + done.stderr
    outcome = json.loads(done.stdout.splitlines()[-1])
    assert outcome["holds"] is True
    assert outcome["figures"]["goals_met"] + outcome["figures"]["failures_attributed"] == 1
    assert outcome["figures"]["commands"] > 150


def test_a_world_outlives_its_watchdog_and_what_was_achieved_is_kept(planes):
    kill(planes, "watchdog")
    tend_until(planes, planes.tend)

    goal, sessions = planes.read_goal()
    assert goal.verdict == "success"
    assert planes.restarts["watchdog"] == 1
    assert count_worlds(planes) == 1
    assert "runner_lost" in {status.execution.ended for status in sessions}
    assert goal.replans <= 1
    assert find_broken_promises(planes) == []


def test_a_killed_world_is_replaced_and_its_session_attributed(planes):
    kill(planes, "world")
    tend_until(planes, planes.tend)

    goal, sessions = planes.read_goal()
    assert goal.verdict == "success"
    assert count_worlds(planes) == 2
    assert "target_lost" in {status.execution.ended for status in sessions}
    assert find_broken_promises(planes) == []


def test_a_second_watchdog_is_refused_and_a_world_that_nobody_supervises_is_ended_by_the_next(planes):
    tend_until(planes, planes.is_watched)
    command = [sys.executable, "-m", "phyagentos", "watch", "--workspace", str(planes.root), "--trust-python"]
    second = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)

    assert second.returncode not in {0, None}
    assert "WATCHED_ALREADY" in second.stderr
    assert "Traceback" not in second.stderr
    assert planes.is_watched()

    kill(planes, "watchdog")
    orphans = [pid for pid, name in find_processes(planes.root).items() if name == "world"]

    assert len(orphans) == 1
    tend_until(planes, lambda: planes.restarts["watchdog"] == 1 and planes.is_watched())
    assert planes.stop() == []


def test_every_bundle_is_sealed_after_all_processes_were_killed_at_once(planes):
    """In the second session, while the worker is too busy to have sealed the bundle of the first."""
    tend_until(planes, lambda: len(list_unsealed(planes.root / "evidence")) > 1 and is_moving(planes))
    for pid in find_processes(planes.root):
        with contextlib.suppress(ProcessLookupError):  # it ended with its parent
            os.kill(pid, signal.SIGKILL)
    tend_until(planes, planes.tend)

    assert planes.restarts == {"watchdog": 1, "agent": 1}
    check_bundles(planes)


def test_every_bundle_is_sealed_after_the_disk_was_full(tmp_path, graph):
    """Where no file system can be mounted, no process that is there may write instead."""
    with small_disk(tmp_path, chaos.DISK_MB) as has_disk:
        planes = Planes(tmp_path / "w", graph, 1, SystemClock())
        try:
            tend_until(planes, lambda: is_moving(planes))
            ballast = fill(tmp_path) if has_disk else tmp_path / "none"
            for pid in [] if has_disk else find_processes(planes.root):
                refuse_writes(pid)
            chaos.wait(planes, chaos.FULL_S, SystemClock())
            ballast.unlink(missing_ok=True)
            allow_writes(planes.root)
            tend_until(planes, planes.tend)
            check_bundles(planes)
        finally:
            planes.stop()
