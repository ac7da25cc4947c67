"""NetHack as a target, in the environment of `--nle-python`: settings, replay, what is seen, and a judged session."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

from benchmarks.nle import LIBRARY
from phyagentos.assembly.paths import OUTCOMES
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.operations.rerun import rerun
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace

KITS = Path(__file__).resolve().parents[2] / "kits"
GOAL = """
goal: deeper
objective: Go down once.
scene: dungeon
targets: {agent: adventurer}
sessions:
  deeper: {skill: go_down, target: agent, with: {depth: 2}, timeout_s: 300}
accept: ["vital(deepest) >= 2"]
"""
GAMES = """
import json
from nle_body.body import NetHackBody
from target_server.wire import Refusal

def see(body):
    state, level = body.read(), body._level
    memory = [sorted(level.visited), sorted(level.searched.items()), sorted(level.failed.items()), sorted(level.killed)]
    return [state.vitals, state.inventory, list(state.base), [each.name for each in body.list_entities()], str(memory)]

def play(seed, snapshot=b"", actions=200):
    body = NetHackBody()
    body.load("dungeon", seed, snapshot)
    while not snapshot and len(body._game.keys) < actions and not body._game.is_over:
        tool = "attack" if body._level.list_foes(1) else "descend" if body._level.down else "explore"
        call = body.call(tool, {})
        while call.is_at_work and len(body._game.keys) < actions:
            body.step((), (), 0.0)
        if call.read().state == "aborted":
            body.call("search", {})
            body.step((), (), 0.0)
    return see(body), body.snapshot()[1], body._game

(one, snapshot, game), (two, _, _), (other, _, _) = play(5), play(5), play(6)
again, _, _ = play(0, snapshot)
settings = [game._env.character, game._env._max_episode_steps, game._env.no_progress_timeout]
body = NetHackBody()
body.act(chr(241) + "y")
ended = [body.read().vitals["health"], body._game.end]
try:
    body.load("dungeon", 0, b"{")
    refused = ""
except Refusal as refusal:
    refused = str(refusal)
print(json.dumps([one == two, one == other, again == one, settings, len(game.keys), ended, refused]))
"""

pytestmark = pytest.mark.extras


@pytest.fixture
def python(pytestconfig):
    return pytestconfig.option.nle_python


def test_a_seed_is_one_game_which_its_keys_repeat_with_what_was_remembered(python):
    environment = os.environ | {"PYTHONPATH": f"{KITS / 'nle'}{os.pathsep}{KITS / 'target_server'}"}
    done = subprocess.run([python, "-c", GAMES], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    is_repeated, is_other, is_resumed, settings, n_keys, ended, refused = json.loads(done.stdout)
    assert (is_repeated, is_other, is_resumed) == (True, False, True)
    assert settings == ["@", 100_000, 150], "BALROG's"
    assert n_keys >= 50
    assert ended == [0.0, "quit"]
    assert "no game of NetHack" in refused


def test_a_session_in_it_is_judged_by_the_screen_and_repeated_bit_for_bit(python, tmp_path):
    library = shutil.copytree(LIBRARY, tmp_path / "library")
    profile = library / "robots" / "adventurer" / "target.yaml"
    text = yaml.safe_load(profile.read_text()) | {"settings": {"module": "nle_body", "python": python}}
    profile.write_text(yaml.safe_dump(text))
    (library / "goal_graphs" / "deeper.yaml").write_text(GOAL)
    workspace = Workspace.create(tmp_path / "w", Library.open(library))
    with open_bench(workspace, SystemClock()) as agent:
        report = agent.mission.run(library / "goal_graphs" / "deeper.yaml", seed=101, goal="deeper")

    assert report.verdict == "success"
    (line,) = map(json.loads, (workspace.root / OUTCOMES).read_text().splitlines())
    assert line["depth"] == 2
    assert "progress" not in workspace.root.joinpath("ENVIRONMENT.md").read_text(), "BALROG's metric stays outside"
    assert rerun(workspace.root, report.sessions[0].id).differences == ()
