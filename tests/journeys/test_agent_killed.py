"""An agent that is killed at any point goes on, when it is started again, to the same end."""

import itertools
import re
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path

import msgspec
import pytest

from phyagentos.cli.outcome import ExitCode
from phyagentos.fork_server import start_python
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.session import SessionStatus
from phyagentos.protocol.sessions.tasks import GoalStatus
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.follower import Follower
from phyagentos.store.journal import choose_partition
from phyagentos.store.ledger import Ledger
from phyagentos.store.records import Record

HERE = Path(__file__).parent
BENCH = HERE.parents[1] / "benchmarks" / "library"
COUNT = HERE / "count.yaml"

pytestmark = pytest.mark.journey


class Planes:
    """A watched workspace, in which agents are started and killed. Each goal has a seed of its own."""

    def __init__(self, root: Path, project: Path, graph: Path) -> None:
        self.workspace = Workspace.create(root, Library.open(project))
        self.graph = graph
        command = ["-m", "phyagentos", "watch", "--workspace", str(root), "--no-pictures", "--trust-python"]
        self._log = (self.workspace.logs / "planes.log").open("wb")
        self._watch = start_python(command, self._log)
        while not list(self.workspace.sessions.iterdir()):
            if self._watch.poll() is not None:
                self._log.close()
                pytest.fail((self.workspace.logs / "planes.log").read_text())
        self._lane = self.workspace.sessions / choose_partition(self.workspace.sessions)
        self._follower, self._records = Follower(self._lane), []
        command = [sys.executable, str(HERE / "dying_agent.py"), str(graph), str(root)]
        pipe = subprocess.PIPE
        self._agents = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=self._log, text=True)

    def run_agent(self, seed: int, n: int = 0, moment: str = "before") -> int:
        """The exit code of an agent; with `n`, of one that kills itself at that write to the journal."""
        self._start_agent(seed, n, moment)
        return self._wait_for_agent()

    def finish(self, seed: int) -> None:
        """Start an agent again and let it come to its end."""
        assert self.run_agent(seed) == ExitCode.GOAL_MET, self.read_log()

    def read_story(self, seed: int) -> tuple[object, ...]:
        return tell(*self.read_goal(seed))

    def read_goal(self, seed: int) -> tuple[GoalStatus, list[SessionStatus], list[Record]]:
        ledger, name = Ledger(forgets=False), f"{self.graph.stem}-{seed}"
        records = [record for record in self._read_records() if _get_goal(record) == name]
        for record in records:
            ledger.apply(record)
        (goal,) = ledger.goals.values()
        return goal, list(ledger.sessions.values()), records

    def read_log(self) -> str:
        return (self.workspace.logs / "planes.log").read_text()

    def stop(self) -> None:
        self._agents.communicate(timeout=30)
        self._watch.terminate()
        self._watch.wait(30)
        self._follower.close()
        self._log.close()

    def _start_agent(self, seed: int, n: int = 0, moment: str = "before") -> int:
        print(seed, n, moment, file=self._agents.stdin, flush=True)
        return int(self._agents.stdout.readline())

    def _wait_for_agent(self) -> int:
        return int(self._agents.stdout.readline())

    def _read_records(self) -> list[Record]:
        self._records += self._follower.read_new()
        return self._records


def _get_goal(record: Record) -> str:
    return re.split(r"[./]", record.id.removeprefix("goal:").removeprefix("node:"))[0]


def tell(goal: GoalStatus, sessions: list[SessionStatus], records: list[Record]) -> tuple[object, ...]:
    """What must not depend on how often the agent died: verdicts, criteria, sessions, replans, and what was recorded.

    The goal's own name is left out.
    """

    def without_name(criteria: object) -> str:
        return msgspec.json.encode(criteria).decode().replace(goal.id, "goal")

    counted = Counter((record.id.replace(goal.id, "goal"), record.ev) for record in records)
    return (
        (
            goal.verdict,
            without_name(goal.criteria),
            goal.replans,
            {name: node.state for name, node in goal.nodes.items()},
        ),
        [
            (
                status.contract.id.removeprefix(goal.id),
                (status.contract.parent or "").removeprefix(goal.id),
                status.contract.attempt,
                status.state,
                [(attempt.verdict, attempt.cause, without_name(attempt.criteria)) for attempt in status.attempts],
            )
            for status in sessions
        ],
        sorted(counted.items()),
    )


@pytest.fixture(scope="module")
def counter(tmp_path_factory):
    planes = Planes(tmp_path_factory.mktemp("killed") / "w", BENCH, COUNT)
    planes.finish(1)
    yield planes
    planes.stop()


def test_an_undisturbed_run_spends_two_replans_and_submits_every_session_once(counter):
    goal, sessions, records = counter.read_goal(1)

    assert (goal.verdict, goal.replans) == ("success", 2)
    assert [status.contract.id.removeprefix("count-1.") for status in sessions] == [
        "high",
        "high.r1",
        "high.r2",
        "left",
        "right",
        "last",
    ]
    assert max(Counter((record.id, record.ev) for record in records if record.ev == "submit").values()) == 1


def test_an_agent_killed_at_any_of_its_writes_comes_to_the_same_end(counter):
    """Before a write is after the one before it, but for the first."""
    expected, seeds = counter.read_story(1), itertools.count(100)
    points = [(1, "before"), *((n, moment) for n in range(1, 40) for moment in ("middle", "after"))]
    for count, (n, moment) in enumerate(points):
        seed = next(seeds)
        code = counter.run_agent(seed, n, moment)
        if code != -signal.SIGKILL:
            assert (code, count > 14) == (0, True)
            return
        counter.finish(seed)
        assert counter.read_story(seed) == expected, f"killed {moment} write {n}"
    pytest.fail("no agent came to its end")
