"""The command line, called in this process; and a journal, written as both planes would."""

import msgspec
import pytest

from phyagentos.operations.progress import RunFold
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Ended, Execution, Scene
from phyagentos.protocol.sessions.verdicts import Attempt, Criterion, Verdict
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.truth import Truth
from phyagentos.store.journal import Entry, Journal
from phyagentos.store.ledger import Ledger
from phyagentos.testing import ManualClock, make_contract

GOAL = "tidy-7"
NODES = {
    "red": {"objective": "red cube into red tray", "skill": "pick_and_place", "target": "arm", "after": []},
    "blue": {"objective": "blue beside red", "skill": "pick_and_place", "target": "arm", "after": ["red"]},
}


class Run:
    """Both planes' pens on one journal."""

    def __init__(self, root) -> None:
        self.workspace = Workspace.create(root, Library(()))
        self.clock = ManualClock()
        self.pens = {
            side: Journal(self.workspace.root, side=side, by=side.value, clock=self.clock, durable=False)
            for side in Side
        }
        self.fold = RunFold(self.workspace, GOAL, Ledger(forgets=False))

    def write(self, side: Side, id: str, ev: str, epoch: int | None = None, /, **body: object) -> None:
        self.clock.advance(1.0)
        self.pens[side].commit([Entry(id, ev, body or None, epoch)])
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
        self.write(Side.RUNTIME, id, "claim")
        self.write(Side.RUNTIME, id, "check", 1)
        self.write(Side.RUNTIME, id, "start", 1)
        execution = Execution(
            ended=ended,
            evidence=f"evidence/{id}",
            code="GRASP_LOST",
            leaf="pick_and_place/place/lower",
            sim_time_s=6.5,
        )
        self.write(Side.RUNTIME, id, "halt", 1)
        self.write(Side.RUNTIME, id, "finish", 1, execution=msgspec.to_builtins(execution))

    def judge(self, id: str, verdict: Verdict, truth: Truth) -> None:
        self.write(Side.AGENT, id, "verify")
        criterion = Criterion(
            text="inside(red_cube, red_tray)", kind="accept", truth=truth, measured={"distance_m": 0.31}
        )
        attempt = Attempt(verdict=verdict, criteria=(criterion,), cause="" if truth is Truth.TRUE else "GRASP_LOST")
        trigger = {Verdict.SUCCESS: "accept", Verdict.FAILURE: "refuse", Verdict.REPLAN: "replan"}[verdict]
        self.write(Side.AGENT, id, trigger, attempt=msgspec.to_builtins(attempt))

    def end(self, verdict: str) -> None:
        self.write(Side.AGENT, f"goal:{GOAL}", "goal_verdict", verdict=verdict, criteria=[], reason="because")


@pytest.fixture
def run(tmp_path):
    run = Run(tmp_path / "w")
    yield run
    for pen in run.pens.values():
        pen.close()


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
