"""Safety events are lessons: with a cause of their own, where they may happen again, and until they are rare."""

import pytest

from phyagentos.agent.memory.episodes import Surroundings, find_episode
from phyagentos.protocol.sessions.lifecycle import SessionState
from phyagentos.protocol.sessions.memory_entries import EntryState, Risk
from phyagentos.protocol.sessions.session import Ended, Execution, SessionStatus
from phyagentos.protocol.sessions.verdicts import Attempt, Verdict
from phyagentos.testing import make_contract

from .conftest import SLOW, ask, make_correction, make_episode, teach

STOPPED = {"ok": False, "cause": "SAFETY_STOP", "safety": ("ESTOPPED",)}


@pytest.mark.parametrize(
    ("ended", "code", "cause", "safety"),
    [
        (Ended.SAFETY_STOP, "ESTOPPED", "SAFETY_STOP", ("ESTOPPED",)),
        (Ended.SAFETY_STOP, "JOINT_VELOCITY", "SAFETY_STOP", ("JOINT_VELOCITY",)),
        (Ended.COMPLETED, "", "CONSTRAINT_VIOLATED", ("CONSTRAINT_VIOLATED",)),
        (Ended.SKILL_FAILED, "GRASP_LOST", "GRASP_LOST", ()),
    ],
)
def test_an_episode_names_what_stopped_it_for_safety(ended, code, cause, safety):
    contract = make_contract(parameters={"object": "cube"}, accept=("holding(panda, cube)",))
    attempt = Attempt(verdict=Verdict.REPLAN, found=Verdict.REPLAN, criteria=(), cause=cause)
    execution = Execution(ended=ended, evidence="evidence/g.n", code=code)
    status = SessionStatus(contract=contract, state=SessionState.REPLANNED, execution=execution, attempts=(attempt,))
    episode = find_episode(status, Surroundings(skills={}, scenes={}, targets={}))
    assert (episode.safety, episode.cause) == (safety, cause)


def test_one_safety_event_is_a_lesson_at_once_with_its_bundle(memory):
    stopped = make_episode(**STOPPED)
    memory.record([stopped])
    (lesson,) = memory.experience.list_lessons()
    assert (lesson.state, lesson.cause, lesson.risk) == (EntryState.ACTIVE, "ESTOPPED", Risk.HIGH)
    assert (lesson.evidence, lesson.verified_by) == ((stopped.evidence,), stopped.session)
    assert not lesson.advice
    assert not lesson.means
    (caution,) = memory.warn(ask(stopped))
    assert caution.id == lesson.id
    assert memory.warn(ask(stopped, object="cup")) == ()
    assert memory.warn(ask(stopped, scene="elsewhere")) == ()


def test_events_that_an_earlier_release_recorded_count_under_their_present_code(memory):
    for code in ("HOLD_VIOLATED", "CONSTRAINT_VIOLATED", "HOLD_BROKEN"):
        memory.record([make_episode(**STOPPED | {"safety": (code,)})])
    (lesson,) = memory.experience.list_lessons()
    assert (lesson.cause, lesson.supported) == ("CONSTRAINT_VIOLATED", 3)


def test_a_condition_that_was_violated_is_known_to_every_skill_that_wants_to_know(memory):
    broken = {"ok": False, "cause": "CONSTRAINT_VIOLATED", "safety": ("CONSTRAINT_VIOLATED",)}
    memory.record([make_episode(**broken, violated=(text,)) for text in ("upright(cup)", "upright(jug)")])
    lessons = memory.experience.list_lessons()
    assert {(each.condition, each.supported) for each in lessons} == {("upright(cup)", 1), ("upright(jug)", 1)}
    other = make_episode(skill="push")
    assert memory.list_violated(ask(other)) == ("upright(cup)", "upright(jug)")
    assert memory.list_violated(ask(other, scene="elsewhere")) == ()


def test_a_caution_lapses_once_many_sessions_passed_without_another_event(memory):
    memory.record([make_episode(**STOPPED)])
    memory.record([make_episode() for _ in range(20)])
    (lesson,) = memory.experience.list_lessons()
    assert (lesson.state, lesson.supported, lesson.contradicted) == (EntryState.ACTIVE, 1, 20)
    memory.record([make_episode() for _ in range(60)])
    assert memory.experience.list_lessons()[0].state is EntryState.EXPIRED
    memory.record([make_episode(**STOPPED) for _ in range(9)])
    assert memory.experience.list_lessons()[0].state is EntryState.ACTIVE


def test_a_lesson_that_a_safety_event_followed_is_used_no_more(memory):
    failed = teach(memory)
    (found,) = memory.recall(ask(failed))
    memory.record([make_episode(**STOPPED, strategy=SLOW, advised_by=(found.lesson.id,))])
    assert memory.recall(ask(failed)) == ()
    entry = next(each for each in memory.experience.list_lessons() if each.id == found.lesson.id)
    assert entry.state is EntryState.EXPIRED
    assert "a safety event met" in entry.reason


def test_at_high_risk_a_lesson_must_surely_do_better_than_nothing(memory):
    failed = teach(memory)
    assert memory.recall(ask(failed))
    memory.record([make_episode(**STOPPED, item="soap")])
    assert memory.recall(ask(failed)) == (), "one success is not enough"
    for _ in range(4):
        memory.record(make_correction())
    assert memory.recall(ask(failed)), "five are"


def test_what_was_verified_at_normal_risk_is_not_used_where_conditions_must_hold(memory):
    failed = teach(memory, risk=Risk.NORMAL)
    assert memory.recall(ask(failed))
    assert memory.recall(ask(failed, risk=Risk.GUARDED)) == ()


def test_of_two_lessons_as_good_the_one_of_the_same_goal_comes_first(memory):
    for graph, speed in (("breakfast", 0.5), ("dinner", 0.6), ("lunch", 0.7)):
        failed = make_episode(ok=False, graph=graph)
        memory.record([failed, make_episode(parent=failed, graph=graph, strategy=SLOW.__class__(speed=speed))])
    for graph, speed in (("breakfast", 0.5), ("dinner", 0.6), ("lunch", 0.7)):
        first, *_ = memory.recall(ask(failed, goal=graph))
        assert first.lesson.advice.speed == speed
