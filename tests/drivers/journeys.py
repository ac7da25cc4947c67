"""A watched workspace in which a goal moves an emulated robot, and what can be done to it meanwhile."""

import json
import threading
from pathlib import Path

from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.operations.why import why
from phyagentos.protocol.sessions.estop import Latch, latch
from tests.following import wait_until

GOAL = Path(__file__).parent / "goal.yaml"
LIMIT_S = 120.0


class Journey:
    """One goal on one target."""

    def __init__(self, workspace, target, tmp_path):
        self.workspace, self.target = workspace, target
        self.goal = tmp_path / "goal.yaml"
        self.goal.write_text(GOAL.read_text().replace("TARGET", target))
        self._planes = open_bench(workspace, SystemClock())
        self.mission = self._planes.__enter__().mission

    def begin(self):
        """Pursue the goal in a thread, until the robot has been commanded for a while."""
        self._reports = []
        run = lambda: self._reports.append(self.mission.run(self.goal, seed=1, goal="nod"))  # noqa: E731
        self._thread = threading.Thread(target=run, daemon=True)
        self._thread.start()
        wait_until(lambda: self._reports or self.count("Command") >= 10, "a motion", LIMIT_S)
        return self

    def finish(self):
        self._thread.join(LIMIT_S)
        return self._reports[0]

    def stop(self):
        """Press the emergency stop; the session ends by it."""
        latch(self.workspace.signals.parent, Latch(by="test", reason="a hand in the cell"))
        assert [(each.ended, each.code) for each in self.finish().sessions] == [("safety_stop", "ESTOPPED")]

    def explain_loss(self):
        """Why the session ended as one of a lost target."""
        (session,) = self.finish().sessions
        assert (session.ended, session.code) == ("target_lost", "TARGET_LOST")
        return "\n".join(why(self.workspace.root, session.id).explanation)

    def count(self, kind):
        log = self.workspace.logs / f"receive-{self.target}.jsonl"
        written = log.read_text().rpartition("\n")[0] if log.exists() else ""
        return sum(json.loads(line)["kind"] == kind for line in written.splitlines())

    def close(self):
        self._planes.__exit__(None, None, None)
