"""The command line, called in this process; and a journal, written as both planes would."""

from collections.abc import Sequence

import msgspec
import pytest

from phyagentos.operations.progress import RunFold
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Ended, Scene
from phyagentos.protocol.sessions.verdicts import Attempt, Criterion, Verdict
from phyagentos.protocol.world.truth import Truth
from phyagentos.store.ledger import Ledger
from phyagentos.testing import ManualClock, make_contract
from tests.pens import Pens

GOAL = "tidy-7"
NODES = {
    "red": {"objective": "red cube into red tray", "skill": "pick_and_place", "target": "arm", "after": []},
    "blue": {"objective": "blue beside red", "skill": "pick_and_place", "target": "arm", "after": ["red"]},
}


class Run(Pens):
    """Both planes' pens on one journal; a record a second."""

    def __init__(self, root) -> None:
        super().__init__(root, ManualClock())
        self.fold = RunFold(self.workspace, GOAL, Ledger(forgets=False))

    def write(self, side: Side, id: str, ev: str, epoch: int | None = None, /, **body: object) -> None:
        self.clock.advance(1.0)
        super().write(side, id, ev, epoch, **body)
        self.fold.apply(self.pens[Side.OPERATOR].read_new())

    def begin(self) -> None:
        self.write(Side.AGENT, f"goal:{GOAL}", "goal_submitted", graph="tidy", seed=7, objective="Tidy up.")
        self.write(Side.AGENT, f"goal:{GOAL}", "goal_compiled", nodes=NODES, accept=[], constraints=[])
        self.write(Side.AGENT, f"node:{GOAL}/red", "node_ready")

    def submit(self, node: str, parent: str | None = None) -> str:
        attempt = 1 if parent else 0
        session = make_contract(
            id=f"{GOAL}.{node}" + (f".r{attempt}" if parent else ""),
            goal=GOAL,
            node=node,
            parent=parent,
            attempt=attempt,
            objective="red cube into red tray",
            accept=("inside(red_cube, red_tray)",),
            scene=Scene(name="tabletop", seed=7, episode="e"),
        )
        self.write(Side.AGENT, session.id, "submit", **msgspec.to_builtins(session))
        return session.id

    def execute(self, id: str, ended: Ended = Ended.SKILL_FAILED) -> None:
        self.claim(id)
        self.finish(id, ended=ended, code="GRASP_LOST", leaf="pick_and_place/place/lower", sim_time_s=6.5)

    def judge(self, id: str, verdict: Verdict, truth: Truth) -> None:
        criterion = Criterion(
            text="inside(red_cube, red_tray)", kind="accept", truth=truth, measured={"distance_m": 0.31}
        )
        cause = "" if truth is Truth.TRUE else "GRASP_LOST"
        self.decide(id, Attempt(verdict=verdict, criteria=(criterion,), cause=cause))

    def end(self, verdict: str, reason: str = "because", criteria: Sequence[Criterion] = ()) -> None:
        plain = msgspec.to_builtins(criteria)
        self.write(Side.AGENT, f"goal:{GOAL}", "goal_verdict", verdict=verdict, criteria=plain, reason=reason)


@pytest.fixture
def run(tmp_path):
    run = Run(tmp_path / "w")
    yield run
    run.close()


@pytest.fixture
def replanned(run):
    run.begin()
    first = run.submit("red")
    run.execute(first)
    run.judge(first, Verdict.REPLAN, Truth.FALSE)
    child = run.submit("red", parent=first)
    run.execute(child)
    run.judge(child, Verdict.SUCCESS, Truth.TRUE)
    run.write(Side.AGENT, f"node:{GOAL}/red", "node_done")
    return run
