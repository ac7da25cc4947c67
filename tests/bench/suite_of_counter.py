"""A suite over the counter: episodes of a second or two, whose scorer reads how high the mark is in the end."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]
GRAPH = """
goal: lift
objective: Three steps up.
scene: counter
targets: {slide: counter}
parameters: {height_m: {type: number, description: How high., default: 0.045}}
defaults: {max_replans: 2}
sessions:
  high:
    skill: advance
    target: slide
    accept: ["height(mark) >= ${height_m}"]
accept: ["height(mark) >= ${height_m}"]
"""
EYE = '''
"""Reads the last observation of an episode; nothing of a verdict."""
import json
from phyagentos.bench.scorers.scorer import Scorer

def read(bundle):
    return json.loads((bundle / "environment_after.json").read_text())["entities"]["mark"]["pose"]["position_m"][2]

def score(parts, workspace, bundle):
    bundles = [bundle] if bundle else list((workspace / "evidence").glob("*.*"))
    highest = max(map(read, bundles), default=0.0)
    return {part: highest >= least for part, least in parts.items()}

HEIGHT = Scorer(name="height", check=lambda located, path, condition: [], score=score)
'''
RIDE = """---
skill: ride
description: Moves the mark of a counter as a policy server says.
kind: policy
requires: ["visible(mark)"]
guarantees: ["moved(mark)"]
needs: {observations: [joint_state], actions: [joint_position], capabilities: [counting]}
action_space:
  {representation: joint_position, joints: [slide], rate_hz: 50, chunk_length: 10, gripper: {closed: 0.0, open: 0.1}}
policy:
  policy: lifter/1
  endpoint: "tcp://127.0.0.1:PORT"
  observations: {joint_state: {modality: proprioception, shape: [n_joints], dtype: float64, unit: rad, rate_hz: 50}}
  inference_s: 0.1
---
"""
LIFTER = '''
"""Serves a policy: up to the height that it is started with, in ten rows."""
import sys
from pathlib import Path
import numpy as np
from phyagentos.protocol.capabilities.skill_runtimes import read_skill
from phyagentos.runtime.policies.policy_server import serve_policy

class Lifter:
    def start(self, request):
        pass

    def infer(self, request):
        return np.linspace((0.0, 0.0), (float(sys.argv[1]), 0.0), 10), True

serve_policy(Lifter(), read_skill(Path("skills/ride/SKILL.md"))[0].policy, lambda endpoint: None)
'''
SUITE = {
    "suite": "counting",
    "objective": "Does it count?",
    "tasks": {"lift": {"graph": "goal_graphs/lift.yaml", "score": {"high": 0.045}}},
    "seeds": {"count": 2},
    "scorer": "eye:HEIGHT",
}


def make_project(folder, **changes):
    """A project with the counter, the eye and the suite, whose keys are replaced by `changes`."""
    shutil.copytree(ROOT / "benchmarks" / "library", folder)
    (folder / "goal_graphs" / "lift.yaml").write_text(GRAPH)
    (folder / "eye.py").write_text(EYE)
    (folder / "suite.yaml").write_text(yaml.safe_dump({**SUITE, **changes}, sort_keys=False))
    return folder


def add_policy(folder, port):
    """A skill whose policy is served at a port by `lifter.py HEIGHT`; the goal asks for it."""
    (folder / "skills" / "ride").mkdir()
    (folder / "skills" / "ride" / "SKILL.md").write_text(RIDE.replace("PORT", str(port)))
    (folder / "lifter.py").write_text(LIFTER)
    graph = folder / "goal_graphs" / "lift.yaml"
    graph.write_text(graph.read_text().replace("skill: advance", "skill: ride"))
    return f"127.0.0.1:{port}"


def make_command(*arguments):
    return [sys.executable, "-m", "phyagentos", "bench", *map(str, arguments)]


def get_environment():
    return os.environ | {"PYTHONPATH": str(ROOT)}


def call(folder, *arguments, code=0):
    """`paos bench …` in the project; the finished process."""
    done = subprocess.run(
        make_command(*arguments),
        cwd=folder,
        env=get_environment(),
        capture_output=True,
        text=True,
        timeout=550,
        check=False,
    )
    assert done.returncode == code, f"{done.returncode}: {done.stdout}{done.stderr}"
    return done


def read_episodes(run):
    """Records of a run by id, as plain data."""
    return {record["id"]: record for record in map(json.loads, (run / "episodes.jsonl").read_text().splitlines())}
