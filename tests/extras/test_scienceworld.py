"""ScienceWorld as a target, in the environment of `--scienceworld-python`: what is seen, replay, judged sessions."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

from benchmarks.scienceworld import LIBRARY, list_tasks, write_project
from benchmarks.scienceworld_parts.understand import understand, write_goal
from phyagentos.assembly.paths import OUTCOMES
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.operations.rerun import rerun
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace

KITS = Path(__file__).resolve().parents[2] / "kits"
WORLDS = """
import json
from scienceworld_body.body import ScienceBody
from target_server.wire import Refusal

body = ScienceBody()

def see():
    state = body.read()
    return [dict(state.inventory), dict(state.vitals), list(state.nearby), len(body._history)]

body.load("house", 0, b"")
before = see()
for action in body.toolbox["fetch"].run(what="metal_pot"):
    body.act(action)
after, (_, snapshot) = see(), body.snapshot()
body.load("house", 1, b"")
body.load("", 0, snapshot)
again = see()
body.act(None)
rested = see()
try:
    body.load("castle", 0, b"")
    refused = ""
except Refusal as refusal:
    refused = str(refusal)
print(json.dumps([before, after, again, rested, refused]))
body.close()
"""

pytestmark = [
    pytest.mark.extras,
    pytest.mark.skipif(shutil.which("java") is None, reason="no Java here: apt-get install openjdk-17-jre-headless"),
]


@pytest.fixture
def python(pytestconfig):
    return pytestconfig.option.scienceworld_python


def test_actions_are_repeated_exactly_and_nothing_is_seen_beyond_the_room(python):
    environment = os.environ | {"PYTHONPATH": f"{KITS / 'scienceworld'}{os.pathsep}{KITS / 'target_server'}"}
    done = subprocess.run([python, "-c", WORLDS], env=environment, capture_output=True, text=True, check=True)
    before, after, again, rested, refused = json.loads(done.stdout)
    assert "metal_pot" not in before[2]
    assert after[0]["metal_pot"] == 1
    assert again == after
    assert rested == after, "the world goes on with the agent's actions alone"
    assert "castle" in refused


def test_a_task_is_understood_run_judged_and_repeated_bit_for_bit(python, tmp_path):
    (task,) = (each for each in list_tasks(Path(python), "train", 1) if each["task"] == "boil")
    library = write_project(tmp_path, [task])
    profile = library / "robots" / "scientist" / "target.yaml"
    text = yaml.safe_load(profile.read_text()) | {"settings": {"module": "scienceworld_body", "python": python}}
    profile.write_text(yaml.safe_dump(text))
    graph = library / "goal_graphs" / "task.yaml"
    graph.write_text(yaml.safe_dump(write_goal("task", "boil", understand(task["description"])), sort_keys=False))
    workspace = Workspace.create(tmp_path / "w", Library.open(library))
    with open_bench(workspace, SystemClock()) as agent:
        report = agent.mission.run(graph, seed=task["variation"], goal="task")

    assert report.verdict == "success"
    *_, last = map(json.loads, (workspace.root / OUTCOMES).read_text().splitlines())
    assert last["score"] == 100
    assert "score" not in workspace.root.joinpath("ENVIRONMENT.md").read_text()
    assert rerun(workspace.root, report.sessions[-1].id).differences == ()
    assert LIBRARY.is_dir()
