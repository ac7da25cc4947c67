"""A memory that outlives the run's workspace: what another workspace found out changes this one's first attempt."""

import json
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from phyagentos.agent.memory.memory import Memory
from phyagentos.clock import SystemClock
from tests.agent.memory.conftest import SLOW, make_correction

pytestmark = pytest.mark.journey

GRAPH = Path(__file__).parent / "goal.yaml"


def paos(*arguments):
    command = [sys.executable, "-m", "phyagentos", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=200)


def test_a_lesson_of_another_workspace_changes_the_session_and_task_md_names_it(tmp_path):
    shared, root = tmp_path / "shared", tmp_path / "w"
    memory = Memory(shared / "memory", clock=SystemClock(), by="another workspace")
    memory.record(make_correction(thing="cube", scene="tabletop/cubes_and_trays"))
    known = set(memory.experience.corrections)

    done = paos("run", GRAPH, "--seed", 1, "--workspace", root, "--memory", shared, "--no-pictures", "--json")
    assert done.returncode == 0, done.stdout + done.stderr
    (session,) = json.loads(done.stdout)["goal"]["sessions"]

    task = (root / "TASK.md").read_text()
    (line,) = (line for line in task.splitlines() if line.startswith(f"- **Memory changed {session['id']}:**"))
    (lesson,) = (id for id in known if id in line)
    assert f"speed {SLOW.speed}: lesson {lesson}" in line
    assert not (root / "memory").exists(), "it is kept in one place"
    told = json.loads(paos("memory", "why", lesson, "-w", shared, "--json").stdout)
    (episode,) = (each for each in told["episodes"] if each["session"] == session["id"])
    assert (episode["strategy"], episode["verdict"]) == (msgspec.to_builtins(SLOW), "success")
    assert Path(episode["evidence"]).samefile(root / "evidence" / session["id"]), "found from anywhere"
