"""A target whose last look left the acceptance undecided gets no other work before the verdict."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import pytest

from phyagentos.protocol.sessions.lifecycle import SessionState
from phyagentos.protocol.sessions.session import Ended, Execution, SessionStatus
from phyagentos.protocol.world.environment import Entity, Environment, Pose
from phyagentos.runtime.execution.criteria import find_open_criteria, is_marginal, is_start_marginal
from phyagentos.runtime.supervision.target_phase import Phase
from phyagentos.runtime.supervision.target_supervisor import VERDICT_S, Supervision, TargetSupervisor
from phyagentos.store.ledger import Ledger
from phyagentos.testing import ManualClock, make_contract

SESSION = make_contract(accept=("inside(red_cube, tray)", "visible(tray)"))


def make_world(**cube: Any) -> Environment:
    tray = Entity(name="tray", kind="tray", movable=False, pose=Pose())
    red = Entity(name="red_cube", kind="cube", pose=Pose(), observed_at_s=9.9)
    entities = {"tray": tray, "red_cube": msgspec.structs.replace(red, **cube)}
    return Environment(time_s=10.0, scene="s", episode="g", revision=1, sensing="perceived", entities=entities)


@pytest.mark.parametrize(
    ("world", "found"),
    [
        (make_world(), ()),
        (make_world(visible=False), ("red_cube",)),
        (make_world(observed_at_s=8.0), ("red_cube",)),
        (msgspec.structs.replace(make_world(), entities={}), ("red_cube", "tray")),
        (msgspec.structs.replace(make_world(visible=False), sensing="truth"), ()),
    ],
)
def test_what_the_acceptance_names_and_nobody_saw_is_undecided(world, found):
    assert find_open_criteria(SESSION, world) == found


@pytest.mark.parametrize("text", ["not moved(*)", "count(inside(*, tray)) >= 1"])
def test_so_is_what_it_covers_by_a_star(text):
    session = msgspec.structs.replace(SESSION, accept=(text,))
    assert find_open_criteria(session, make_world()) == ()
    assert find_open_criteria(session, make_world(observed_at_s=8.0)) == ("red_cube",)


@pytest.mark.parametrize(
    ("text", "cube", "ends", "begins"),
    [
        ("at(red_cube, (0, 0, 0), 0.05)", {}, False, False),
        ("at(red_cube, (0.049, 0, 0), 0.05)", {}, True, False),
        ("at(red_cube, (0, 0, 0), 0.05)", {"confidence": 0.3}, True, False),
        ("at(red_cube, (0, 0, 0), 0.05)", {"visible": False}, False, False),
        ("not moved(red_cube)", {}, False, False),
        ("not moved(red_cube)", {"turn_std_rad": 0.1}, True, True),
        ("not moved(red_cube)", {"turn_std_rad": 0.05}, False, True),  # a look in which it seems to turn would leave it
    ],
)
def test_what_another_look_may_sharpen_is_looked_at_again_before_and_after(text, cube, ends, begins):
    session, world = msgspec.structs.replace(SESSION, accept=(text,)), make_world(**cube)
    assert (is_marginal(session, world, world), is_start_marginal(session, world)) == (ends, begins)


class Target:
    """A supervisor whose session has just ended, and the ledger that it looks at."""

    def __init__(self, *undecided: str, ended: Ended = Ended.COMPLETED) -> None:
        self.clock = ManualClock(100.0)
        self.ledger = Ledger()
        journal = cast(Any, SimpleNamespace(ledger=self.ledger))
        shared = Supervision(
            journal=journal, queues=cast(Any, None), clock=self.clock, logs=Path("logs"), leases=Path("leases")
        )
        self.supervisor = TargetSupervisor("panda", cast(Any, None), cast(Any, None), shared)
        self.supervisor.state = Phase.IDLE
        self.supervisor.note_end(SESSION, Execution(ended=ended, evidence="", open_criteria=undecided))

    def is_free(self, state: SessionState, after_s: float = 0.1) -> bool:
        self.ledger.sessions[SESSION.id] = SessionStatus(contract=SESSION, state=state)
        self.clock.advance(after_s)
        return self.supervisor.is_free()


def test_the_target_waits_for_the_verdict_of_a_session_that_is_undecided():
    target = Target("red_cube")
    assert not target.is_free(SessionState.AWAITING_VERIFICATION)
    assert not target.is_free(SessionState.VERIFYING)
    assert target.is_free(SessionState.REPLANNED)


@pytest.mark.parametrize(("undecided", "after_s"), [(("red_cube",), VERDICT_S), ((), 0.1)])
def test_it_does_not_wait_for_an_agent_that_is_gone_nor_when_everything_was_seen(undecided, after_s):
    assert Target(*undecided).is_free(SessionState.AWAITING_VERIFICATION, after_s)


@pytest.mark.parametrize("ended", [Ended.RUNNER_LOST, Ended.TARGET_LOST, Ended.SAFETY_STOP, Ended.STALLED])
def test_it_waits_for_what_follows_an_interrupted_motion_lest_another_session_let_fall_what_it_holds(ended):
    target = Target(ended=ended)
    assert not target.is_free(SessionState.AWAITING_VERIFICATION)
    assert target.is_free(SessionState.REPLANNED)
