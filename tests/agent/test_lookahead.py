"""What the agent makes of a look-ahead: which way a refused session's child takes, and that none is given up."""

from collections.abc import Callable
from dataclasses import dataclass, field

import msgspec
import pytest

from phyagentos.agent.repair.foreseen import revise_refused
from phyagentos.errors import Problem
from phyagentos.protocol.sessions.evidence import write_json
from phyagentos.protocol.sessions.lookahead import LOOKAHEAD, Alternative, LookaheadResult
from phyagentos.protocol.sessions.session import Session, SessionStatus
from phyagentos.protocol.sessions.strategy import DEFAULT_STRATEGY, Strategy
from phyagentos.testing import make_contract

from .conftest import ScriptedRuntime, make_rejection

GRAPH = """
    goal: careful
    objective: The red cube into its tray.
    scene: table
    targets: {arm: panda}
    defaults: {max_replans: 0, lookahead: {samples: 10, threshold: 0.8}}
    sessions:
      red:
        skill: pick_and_place
        target: arm
        with: {object: red_cube, destination: red_tray}
"""


def make_refused(attempt: int = 0) -> SessionStatus:
    contract = make_contract(id="g.n", node="n", attempt=attempt)
    return SessionStatus(contract=contract, state="rejected", reason="g.n: LOOKAHEAD_LOW: found 4 of 10")


def make_result(*alternatives: Alternative, succeeded: int = 4) -> LookaheadResult:
    causes = {"GRASP_LOST": 10 - succeeded}
    return LookaheadResult(samples=10, succeeded=succeeded, threshold=0.8, causes=causes, alternatives=alternatives)


SLOWER = Alternative(strategy=Strategy(speed=0.5), samples=10, succeeded=9)
SIDEWAYS = Alternative(strategy=Strategy(avoid_grasps=("yaw+000",)), samples=10, succeeded=6)
HOPELESS = Alternative(strategy=Strategy(speed=0.25), samples=1, succeeded=0)


@pytest.mark.parametrize(
    ("alternatives", "attempt", "strategy", "threshold", "reason"),
    [
        pytest.param(
            (SIDEWAYS, SLOWER),
            0,
            SLOWER.strategy,
            None,
            "at half speed it is 9 of 10",
            id="the best way that was rehearsed is taken and looked ahead again",
        ),
        pytest.param(
            (SIDEWAYS, HOPELESS),
            0,
            SIDEWAYS.strategy,
            0.0,
            "4 of 10 rollouts succeed",
            id="where no way is likely enough the best is tried all the same",
        ),
        pytest.param(
            (HOPELESS,),
            0,
            DEFAULT_STRATEGY,
            0.0,
            "none of 1 alternative is better",
            id="where no other way is better the own one is tried",
        ),
        pytest.param(
            (SLOWER,), 1, SLOWER.strategy, 0.0, "at half speed", id="a child that is refused too is not refused again"
        ),
    ],
)
def test_what_was_rehearsed_decides_how_a_refused_session_is_tried(
    tmp_path, alternatives, attempt, strategy, threshold, reason
):
    write_json(tmp_path / LOOKAHEAD, make_result(*alternatives))
    advice = revise_refused(make_refused(attempt), tmp_path)
    assert (advice.strategy, advice.threshold, reason in advice.reasons[0]) == (strategy, threshold, True)


@pytest.mark.parametrize("text", [None, b"{not json"])
def test_without_a_readable_result_there_is_nothing_to_go_by(tmp_path, text):
    if text is not None:
        (tmp_path / LOOKAHEAD).write_bytes(text)

    assert revise_refused(make_refused(), tmp_path) is None


@dataclass
class Foreseeing:
    """Refuses by the results that it is given, one after the other; 0 as the threshold lets everything through."""

    runtime: ScriptedRuntime
    results: list[LookaheadResult]
    seen: list[Session] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._run: Callable[[Session], None] = self.runtime._run
        self.runtime._run = self.decide

    def decide(self, session: Session) -> None:
        self.seen.append(session)
        if session.lookahead is None or session.lookahead.threshold == 0.0 or not self.results:
            self._run(session)
            return
        result = self.results.pop(0)
        folder = self.runtime._workspace.evidence_of(session.id)
        folder.mkdir(parents=True)
        write_json(folder / LOOKAHEAD, result)
        found = f"{result.succeeded} of {result.samples}"
        low = Problem(code="LOOKAHEAD_LOW", address=session.id, found=found)
        self.runtime._journal.commit([make_rejection(session, low)])


def test_a_goal_whose_session_is_refused_is_met_by_its_child_and_no_replan_is_spent(make_stage, write_graph):
    stage = make_stage()
    foreseeing = Foreseeing(stage.runtime, [make_result(SLOWER), make_result(SLOWER)])

    report = stage.pursue(write_graph(GRAPH))

    first, child, last = foreseeing.seen
    assert report.verdict == "success", report
    assert report.first_attempt_success == {"red": True}
    assert [each.lookahead.threshold for each in (first, child, last)] == [0.8, 0.8, 0.0]
    assert [each.strategy for each in (first, child, last)] == [
        DEFAULT_STRATEGY,
        Strategy(speed=0.5),
        Strategy(speed=0.5),
    ]
    assert len({each.lookahead.seed for each in (first, child, last)}) == 3
    assert [each.id for each in stage.runtime.ran] == [last.id]


def test_a_node_may_do_without_look_ahead(make_stage, write_graph):
    stage = make_stage()

    stage.pursue(write_graph(GRAPH + "        lookahead: false\n"))

    assert [each.lookahead for each in stage.runtime.ran] == [None]


def test_a_result_is_the_same_after_a_journey_through_a_file():
    result = make_result(SLOWER, SIDEWAYS)

    assert msgspec.json.decode(msgspec.json.encode(result), type=LookaheadResult) == result
    assert result.is_low
    assert result.likely_cause == "GRASP_LOST"
