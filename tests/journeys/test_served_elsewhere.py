"""A goal on a body that another program serves, by the kit alone, with its network cut in the midst of it."""

import json
import shutil
import threading
import time
from pathlib import Path

import pytest
import yaml

from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.workspace.workspace import Workspace
from tests.certificates import make_certificate
from tests.faulty_network import FaultyNetwork
from tests.following import wait_until
from tests.served_kit import Served, lead_elsewhere

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
        (there := folder / "there" / "logs").mkdir(parents=True)
        both, alone = make_certificate(folder)
        self.served = Served(there, SLOW, options=("--certificate", str(both)))
        self.network = FaultyNetwork(int(self.served.start().rpartition(":")[2]))
        endpoint, more = f"wss://127.0.0.1:{self.network.port}", f"silence_max_s: {SILENCE_S}\n"
        secret = lead_elsewhere(self.workspace, "counter", endpoint, self.served.key.hex(), more)
        shutil.copy(alone, secret.with_name("counter.pem"))

    def read(self, goal):
        """Commands of a goal that the body accepted: session, epoch, number."""
        lines = [json.loads(line) for line in self.served.log.read_bytes().splitlines()]
        taken = [line for line in lines if line["kind"] == "Command" and line.get("accepted", True)]
        ours = [line for line in taken if line["session"].startswith(goal)]
        return [(line["session"], line["epoch"], line["sequence"]) for line in ours]

    def close(self):
        self.served.close()
        self.network.close()


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory):
    made = Elsewhere(tmp_path_factory.mktemp("elsewhere"))
    with open_bench(made.workspace, CLOCK) as agent:
        yield made, agent.mission
    made.close()


def test_a_goal_is_met_on_a_body_that_the_kit_serves_though_its_network_was_gone_for_longer_than_the_lease(elsewhere):
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
