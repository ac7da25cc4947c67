"""Which snapshot of a goal is the latest: by the order in which sessions ended, not by the world's own time."""

from pathlib import Path

import pytest

from phyagentos.agent.judging.goal_judgement import Evidence
from phyagentos.protocol.sessions.evidence import Bundle
from phyagentos.protocol.sessions.lifecycle import SessionState
from phyagentos.protocol.sessions.session import Ended, Execution, SessionStatus
from phyagentos.protocol.world.environment import Environment
from phyagentos.store.views.environment import render_environment
from phyagentos.testing import make_contract


class Told(Evidence):
    """Bundles that are told instead of read: the time of the world before and after each session [s]."""

    def __init__(self, times) -> None:
        super().__init__(Path())
        self._times = times

    def _read(self, status, with_course):
        before_s, after_s = self._times[status.contract.id]
        return Bundle(
            folder=Path(), session=status.contract, execution=status.execution, before=see(before_s),
            after=see(after_s), holds=(), trace=(), events=(),
        )  # fmt: skip


def see(time_s) -> Environment:
    return Environment(time_s=time_s, scene="s", episode="e", revision=1, sensing="truth", entities={})


def make_status(id, state=SessionState.AWAITING_VERIFICATION, updated_at="") -> SessionStatus:
    execution = Execution(ended=Ended.COMPLETED, evidence=f"evidence/{id}")
    contract = make_contract(id=id, node=id)
    return SessionStatus(contract=contract, state=state, execution=execution, updated_at=updated_at)


BEFORE_THE_LOSS, AFTER_IT = ("a", (0.0, 20.0)), ("b", (0.5, 4.0))  # the second world began anew


@pytest.fixture
def evidence():
    return Told(dict([BEFORE_THE_LOSS, AFTER_IT]))


def test_a_world_that_began_anew_is_later_though_its_clock_shows_less(evidence):
    for id in ("a", "b"):
        evidence.read(make_status(id))

    assert (evidence.all.initial.time_s, evidence.all.now.time_s) == (0.0, 4.0)
    assert evidence.all.now_file.startswith("evidence/b/")


@pytest.mark.parametrize("order", [("a", "b"), ("b", "a")])
def test_what_an_earlier_agent_judged_is_ordered_by_its_verdicts(evidence, order):
    at = {"a": "2026-01-01T10:00:00Z", "b": "2026-01-01T10:00:05Z"}
    for id in order:
        evidence.take_in(make_status(id, SessionState.SUCCEEDED, at[id]))

    assert (evidence.all.initial.time_s, evidence.all.now.time_s) == (0.0, 4.0)


def test_what_is_published_of_another_episode_says_nothing_about_this_one(tmp_path):
    (tmp_path / "ENVIRONMENT.md").write_text(render_environment(see(1.0)), encoding="utf-8")
    evidence = Evidence(tmp_path)
    assert evidence.find_latest(see(1.0).episode) is not None
    assert evidence.find_latest("another") is None
