"""Crafter as a target, in the environment of `--crafter-python`: order, view, tools, and a session that is judged."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

from benchmarks.crafter import LIBRARY
from phyagentos.assembly.paths import OUTCOMES
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.operations.rerun import rerun
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace

KITS = Path(__file__).resolve().parents[2] / "kits"
GOAL = """
goal: wood
objective: Carry wood.
scene: wilds
targets: {agent: survivor}
sessions:
  wood: {skill: obtain, target: agent, with: {what: wood, amount: 3}, timeout_s: 60}
accept: ["holds(wood) >= 3"]
"""
LIVES = """
import json
from crafter_body.body import CrafterBody

def live(seed, snapshot=b""):
    body = CrafterBody()
    body.load("wilds", seed, snapshot)
    if not snapshot:
        first = len(body._map.cells)
        for action in body.collect("wood", 4):
            body.act(action)
        for _ in range(200):
            body.act(None)
    creatures = sorted(map(str, body._map.creatures.items()))
    state = [body.read().vitals, body.read().inventory, creatures, str(sorted(body._map.cells.items()))]
    return state, body.snapshot()[1], first if not snapshot else 0

def rest():
    body = CrafterBody()
    body.load("wilds", 1, b"")
    for tool, *arguments in (("collect", "wood", 5), ("place", "table"), ("make", "wood_pickaxe"), ("sleep",)):
        for action in body.toolbox[tool].run(*arguments):
            if action == "sleep" and not body._env._player.sleeping:
                walled = body._is_walled_in()
            body.act(action)
    return walled, body.read().vitals["awake"], body._env._player.achievements["wake_up"] > 0

(one, snapshot, first), (two, _, _), (other, _, _) = live(3), live(3), live(4)
print(json.dumps([one == two, one == other, live(3, snapshot)[0] == one, first, one[1], rest()]))
"""

pytestmark = pytest.mark.extras


@pytest.fixture
def python(pytestconfig):
    return pytestconfig.option.crafter_python


def test_a_seed_is_one_life_which_its_actions_repeat_and_nothing_is_seen_beyond_the_view(python):
    environment = os.environ | {"PYTHONPATH": f"{KITS / 'crafter'}{os.pathsep}{KITS / 'target_server'}"}
    done = subprocess.run([python, "-c", LIVES], env=environment, capture_output=True, text=True, check=True)
    is_repeated, is_other, is_resumed, first, inventory, rested = json.loads(done.stdout)
    assert (is_repeated, is_other, is_resumed) == (True, False, True)
    assert first == 9 * 7
    assert inventory["wood"] == 4
    assert rested == [True, 1.0, True], "it slept behind walls, and is awake"


def test_a_session_in_it_is_judged_by_what_is_carried_and_repeated_bit_for_bit(python, tmp_path):
    library = shutil.copytree(LIBRARY, tmp_path / "library")
    profile = library / "robots" / "survivor" / "target.yaml"
    text = yaml.safe_load(profile.read_text()) | {"settings": {"module": "crafter_body", "python": python}}
    profile.write_text(yaml.safe_dump(text))
    (library / "goal_graphs" / "wood.yaml").write_text(GOAL)
    workspace = Workspace.create(tmp_path / "w", Library.open(library))
    with open_bench(workspace, SystemClock()) as agent:
        report = agent.mission.run(library / "goal_graphs" / "wood.yaml", seed=1, goal="wood")

    assert report.verdict == "success"
    (line,) = map(json.loads, (workspace.root / OUTCOMES).read_text().splitlines())
    assert "collect_wood" in line["completed"]
    assert rerun(workspace.root, report.sessions[0].id).differences == ()
