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

from phyagentos.assembly.agent_plane import MemoryUse, open_agent
from phyagentos.assembly.paths import TOKENS
from phyagentos.assembly.planes import start_watch
from phyagentos.clock import SystemClock
from phyagentos.operations.why import why
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.targets.handshake import make_key
from tests.certificates import make_certificate
from tests.faulty_network import FaultyNetwork

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

    def __init__(self, folder, with_tls=False):
        library = shutil.copytree(ROOT / "benchmarks" / "library", folder / "library")
        (library / "trees" / "advance.yaml").write_text(TREE)
        self.workspace = Workspace.create(folder / "w", Library.open(library))
        (self.workspace.root / "lift.yaml").write_text(GOAL)
        contract = yaml.safe_load(self.workspace.runtime_contract.read_text())
        self.workspace.runtime_contract.write_text(yaml.safe_dump(contract | {"lease_s": LEASE_S}))
        key = make_key().hex()
        self.log = folder / "there" / "logs" / "receive-counter.jsonl"
        self.log.parent.mkdir(parents=True)
        both, alone = make_certificate(folder) if with_tls else (None, None)
        self.process, port = self._serve(folder / "there", key, ["--certificate", str(both)] if with_tls else [])
        self.network = FaultyNetwork(port)
        endpoint = f"{'wss' if with_tls else 'ws'}://127.0.0.1:{self.network.port}"
        told = f"driver: remote\nendpoint: {endpoint}\nsilence_max_s: {SILENCE_S}\n"
        registry = self.workspace.target_registry
        registry.write_text(registry.read_text().replace("target: counter\n", f"target: counter\n{told}"))
        secret = self.workspace.root / TOKENS / "counter"
        secret.parent.mkdir(parents=True)
        secret.touch(mode=0o600)
        secret.write_text(key)
        if with_tls:
            shutil.copy(alone, secret.with_name("counter.pem"))

    def _serve(self, folder, key, options):
        shutil.copy(ROOT / "examples" / "projects" / "05_any_body" / "slide.py", folder)
        (folder / "slow.py").write_text(SLOW)
        command = [sys.executable, str(folder / "slow.py"), "--log", str(self.log), *options]
        environment = os.environ | {"PYTHONPATH": str(ROOT / "kits" / "target_server")}
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        process = subprocess.Popen(command, text=True, env=environment, **pipes)
        process.stdin.write(f"{key}\n")
        process.stdin.flush()
        return process, int(process.stdout.readline().rpartition(":")[2])

    def read(self, session=None):
        """Commands that the body accepted: session, epoch, number."""
        lines = [json.loads(line) for line in self.log.read_bytes().splitlines()]
        taken = [line for line in lines if line["kind"] == "Command" and line.get("accepted", True)]
        return [(line["session"], line["epoch"], line["sequence"]) for line in taken]

    def wait_for_commands(self, count):
        """Until so many commands were accepted."""
        deadline_s = time.monotonic() + 60.0  # noqa: TID251
        while len(self.read()) < count and time.monotonic() < deadline_s:  # noqa: TID251
            time.sleep(0.02)  # noqa: TID251
        assert len(self.read()) >= count

    def close(self):
        self.process.stdin.close()
        assert self.process.wait(15.0) == 0
        self.process.stdout.close()
        self.network.close()


@pytest.fixture
def elsewhere(tmp_path):
    made = Elsewhere(tmp_path)
    yield made
    made.close()


def pursue(elsewhere, meanwhile=lambda: None):
    """The goal, while something happens to its target: its report, and each session's status."""
    thread = threading.Thread(target=meanwhile)
    with (
        start_watch(elsewhere.workspace, pictures=False).running(CLOCK),
        open_agent(elsewhere.workspace, CLOCK, by="journey", memory_use=MemoryUse.NONE) as agent,
    ):
        thread.start()
        report = agent.mission.run(elsewhere.workspace.root / "lift.yaml", seed=0)
        thread.join()
        ledger = agent.mission.ledger
        told = ["\n".join(why(elsewhere.workspace.root, each.id).explanation) for each in report.sessions]
        return report, [ledger.sessions[each.id] for each in report.sessions], told


def test_a_goal_is_met_on_a_body_that_the_kit_serves(tmp_path):
    elsewhere = Elsewhere(tmp_path, with_tls=True)
    elsewhere.network.delay_s = 0.1
    report, _, (explanation,) = pursue(elsewhere)
    elsewhere.close()

    assert report.verdict == "success"
    assert "driver remote/slide" in explanation
    assert [number for _, _, number in elsewhere.read()] == list(range(1, 21)), "delay costs time alone"


def test_a_network_that_is_gone_for_longer_than_the_lease_costs_the_session_alone(elsewhere):
    def fail():
        elsewhere.wait_for_commands(5)
        elsewhere.network.cut()
        time.sleep(LEASE_S + 3.0)  # noqa: TID251
        elsewhere.network.mend()

    report, statuses, _ = pursue(elsewhere, fail)

    first, last = statuses[0].execution, statuses[-1].execution
    assert (first.ended, first.code) == (Ended.TARGET_LOST, "TARGET_LOST")
    assert "'counter' at ws://127.0.0.1:" in first.message
    assert (report.verdict, last.ended) == ("success", Ended.COMPLETED)
    assert len(set(taken := elsewhere.read())) == len(taken), "nothing was carried out twice"
