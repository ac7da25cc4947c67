"""Goals on a body that another program serves, by the kit alone: with its network whole, and cut."""

import json
import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import yaml

from phyagentos.assembly.paths import TOKENS
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.operations.why import why
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.targets.handshake import make_key
from tests.certificates import make_certificate
from tests.faulty_network import FaultyNetwork
from tests.following import wait_until

ROOT = Path(__file__).resolve().parents[2]
CLOCK = SystemClock()
SILENCE_S, LEASE_S = 1.5, 3.0
GOAL = """
goal: lift
objective: Twenty steps up.
scene: counter
targets: {slide: counter}
defaults: {max_replans: 3}
sessions:
  high: {skill: advance, target: slide, accept: ["height(mark) >= 0.39"]}
accept: ["height(mark) >= 0.39"]
"""
TREE = "tree: advance\ndescription: Twenty steps.\nroot: {sequence: {children: [" + "advance_one_step, " * 20 + "]}}\n"
SLOW = """
import time

from slide import Slide, main


class Slow(Slide):
    def step(self, *row):
        time.sleep(0.15)
        return super().step(*row)


main(Slow)
"""

pytestmark = pytest.mark.journey


class Elsewhere:
    """A workspace whose slide is served by another program, behind a network that can fail."""

    def __init__(self, folder):
        library = shutil.copytree(ROOT / "benchmarks" / "library", folder / "library")
        (library / "trees" / "advance.yaml").write_text(TREE)
        self.workspace = Workspace.create(folder / "w", Library.open(library))
        (self.workspace.root / "lift.yaml").write_text(GOAL)
        contract = yaml.safe_load(self.workspace.runtime_contract.read_text())
        self.workspace.runtime_contract.write_text(yaml.safe_dump(contract | {"lease_s": LEASE_S}))
        key = make_key().hex()
        self.log = folder / "there" / "logs" / "receive-counter.jsonl"
        self.log.parent.mkdir(parents=True)
        both, alone = make_certificate(folder)
        self.process, port = self._serve(folder / "there", key, both)
        self.network = FaultyNetwork(port)
        told = f"driver: remote\nendpoint: wss://127.0.0.1:{self.network.port}\nsilence_max_s: {SILENCE_S}\n"
        registry = self.workspace.target_registry
        registry.write_text(registry.read_text().replace("target: counter\n", f"target: counter\n{told}"))
        secret = self.workspace.root / TOKENS / "counter"
        secret.parent.mkdir(parents=True)
        secret.touch(mode=0o600)
        secret.write_text(key)
        shutil.copy(alone, secret.with_name("counter.pem"))

    def _serve(self, folder, key, certificate):
        shutil.copy(ROOT / "examples" / "projects" / "05_any_body" / "slide.py", folder)
        (folder / "slow.py").write_text(SLOW)
        command = [sys.executable, str(folder / "slow.py"), "--log", str(self.log), "--certificate", str(certificate)]
        environment = os.environ | {"PYTHONPATH": str(ROOT / "kits" / "target_server")}
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        process = subprocess.Popen(command, text=True, env=environment, **pipes)
        process.stdin.write(f"{key}\n")
        process.stdin.flush()
        return process, int(process.stdout.readline().rpartition(":")[2])

    def read(self, goal):
        """Commands of a goal that the body accepted: session, epoch, number."""
        lines = [json.loads(line) for line in self.log.read_bytes().splitlines()]
        taken = [line for line in lines if line["kind"] == "Command" and line.get("accepted", True)]
        ours = [line for line in taken if line["session"].startswith(goal)]
        return [(line["session"], line["epoch"], line["sequence"]) for line in ours]

    def close(self):
        self.process.stdin.close()
        assert self.process.wait(15.0) == 0
        self.process.stdout.close()
        self.network.close()


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory):
    made = Elsewhere(tmp_path_factory.mktemp("elsewhere"))
    with open_bench(made.workspace, CLOCK) as agent:
        yield made, agent.mission
    made.close()


def test_a_goal_is_met_on_a_body_that_the_kit_serves(elsewhere):
    there, mission = elsewhere
    there.network.delay_s = 0.1
    report = mission.run(there.workspace.root / "lift.yaml", seed=0, goal="calm")
    there.network.delay_s = 0.0

    assert report.verdict == "success"
    assert "driver remote/slide" in "\n".join(why(there.workspace.root, report.sessions[0].id).explanation)
    assert [number for _, _, number in there.read("calm.")] == list(range(1, 21)), "delay costs time alone"


def test_a_network_that_is_gone_for_longer_than_the_lease_costs_the_session_alone(elsewhere):
    there, mission = elsewhere

    def fail():
        wait_until(lambda: len(there.read("cut.")) >= 5)
        there.network.cut()
        time.sleep(LEASE_S + 3.0)  # noqa: TID251
        there.network.mend()

    thread = threading.Thread(target=fail)
    thread.start()
    report = mission.run(there.workspace.root / "lift.yaml", seed=0, goal="cut")
    thread.join()

    first, last = (mission.ledger.sessions[report.sessions[index].id].execution for index in (0, -1))
    assert (first.ended, first.code) == (Ended.TARGET_LOST, "TARGET_LOST")
    assert "'counter' at wss://127.0.0.1:" in first.message
    assert (report.verdict, last.ended) == ("success", Ended.COMPLETED)
    assert len(set(taken := there.read("cut."))) == len(taken), "nothing was carried out twice"
