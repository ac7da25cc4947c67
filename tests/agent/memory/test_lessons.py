"""From failure to lesson: only in this order, only by a verdict, only where it holds."""

import msgspec
import pytest

from phyagentos.agent.memory import methodological
from phyagentos.agent.memory.entries import Count
from phyagentos.protocol.sessions.memory_entries import Embodiment, EntryState
from phyagentos.protocol.sessions.strategy import DEFAULT_STRATEGY, Strategy
from phyagentos.protocol.sessions.verdicts import Verdict

from .conftest import PANDA, SLOW, ask, make_correction, make_episode, teach


def find_lesson(memory, **wanted):
    """The lesson of the very case, not its widened form."""
    lessons = [each for each in memory.experience.list_lessons() if each.scope.scene and each.scope.object]
    return next(each for each in lessons if all(getattr(each, key) == value for key, value in wanted.items()))


def test_a_correction_that_the_verifier_confirmed_is_recalled(memory):
    failed, corrected = make_correction()
    memory.record([failed, corrected])
    (found,) = memory.recall(ask(failed))
    assert found.lesson.advice == SLOW
    lesson = find_lesson(memory, cause="GRASP_LOST")
    assert (lesson.state, lesson.verified_by, lesson.supported) == (EntryState.ACTIVE, corrected.session, 1)
    assert lesson.evidence == (corrected.evidence,)


@pytest.mark.parametrize("verdict", [Verdict.REPLAN, Verdict.FAILURE])
def test_a_correction_that_was_not_confirmed_stays_a_hypothesis_and_is_never_recalled(memory, verdict):
    failed = make_episode(ok=False)
    child = make_episode(ok=False, parent=failed, strategy=SLOW, verdict=verdict)
    memory.record([failed, child])
    assert memory.recall(ask(failed)) == ()
    lesson = find_lesson(memory, cause="GRASP_LOST")
    assert (lesson.state, lesson.verified_by, lesson.contradicted) == (EntryState.HYPOTHESIS, "", 1)


@pytest.mark.parametrize(
    ("change", "order"),
    [
        ({"node": "other"}, 1),
        ({"goal": "other"}, 1),
        ({"parent": "nobody"}, 1),
        ({"strategy": DEFAULT_STRATEGY}, 1),
        ({"parent": None}, 1),
        ({}, -1),
    ],
    ids=[
        "of another node", "of another goal", "of no failure", "that did nothing differently",
        "that continues nothing", "before its failure",
    ],
)  # fmt: skip
def test_a_success_outside_the_line_of_the_failure_verifies_nothing(memory, change, order):
    failed = make_episode(ok=False)
    stranger = make_episode(parent=failed, strategy=SLOW)
    memory.record([failed, msgspec.structs.replace(stranger, **change)][::order])
    assert memory.experience.corrections == {}
    assert memory.recall(ask(failed)) == ()


def test_the_same_session_counts_once(memory):
    pair = make_correction()
    memory.record(pair)
    memory.record(pair)
    assert find_lesson(memory, cause="GRASP_LOST").supported == 1


def test_a_correction_after_two_failures_belongs_to_the_first_cause(memory):
    first = make_episode(ok=False, cause="GRASP_LOST")
    second = make_episode(ok=False, parent=first, strategy=SLOW, cause="PLACED_WRONG")
    third = make_episode(ok=True, parent=second, strategy=Strategy(speed=0.25))
    memory.record([first, second, third])
    (found,) = memory.recall(ask(first))
    assert (found.lesson.advice, found.lesson.cause) == (Strategy(speed=0.25), "GRASP_LOST")
    assert found.lesson.chains[0].failed == first.session


def test_a_look_between_failure_and_correction_belongs_to_the_chain_and_is_no_attempt(memory):
    failed = make_episode(ok=False, cause="EVIDENCE_MISSING")
    look = make_episode(
        ok=False, parent=failed, purpose="inspect", cause="GRASP_MISSED", session=f"{failed.session}.r1"
    )
    corrected = make_episode(parent=look, strategy=Strategy(avoid_grasps=("yaw+090",)), session=f"{failed.session}.r2")
    memory.record([failed, look, corrected])
    (found,) = memory.recall(ask(failed))
    assert (found.lesson.cause, found.lesson.chains[0].failed) == ("GRASP_MISSED", failed.session)
    assert sum(pattern.count.trials for pattern in memory.experience.patterns.values()) == 1


@pytest.mark.parametrize("cause", ["RUNNER_LOST", "TARGET_LOST", "CANCELLED"])
def test_a_session_that_was_interrupted_speaks_neither_for_a_way_nor_against_it(memory, cause):
    first = make_episode(ok=False)
    lost = make_episode(ok=False, parent=first, strategy=SLOW, cause=cause)
    third = make_episode(parent=lost, strategy=SLOW)
    advised = make_episode(ok=False, strategy=SLOW, cause=cause)
    memory.record([first, lost, third, advised, make_episode(ok=False, cause=cause)])
    (found,) = memory.recall(ask(first))
    assert (found.lesson.cause, found.lesson.chains[0].failed) == ("GRASP_LOST", first.session)
    assert found.lesson.outcomes == Count(successes=1, trials=1)
    assert memory.experience.find_baseline(found.lesson) == Count(trials=1)
    assert [(each.strategy, each.count.trials) for each in memory.experience.patterns.values()] == [
        (DEFAULT_STRATEGY, 1)
    ]


def test_what_differed_from_case_to_case_is_left_out_and_what_was_the_same_stays(memory):
    for grasp in ("yaw+000", "yaw+090", "yaw+180"):
        memory.record(make_correction(strategy=Strategy(speed=0.5, avoid_grasps=(grasp,))))
    (found, *_) = memory.recall(ask(make_episode()))
    assert found.lesson.advice == Strategy(speed=0.5)


def test_a_lesson_is_widened_once_it_was_verified_in_two_cases(memory):
    memory.record(make_correction(place="tray"))
    elsewhere = ask(make_episode(place="shelf"))
    assert memory.recall(elsewhere) == ()
    memory.record(make_correction(place="box"))
    (found,) = memory.recall(elsewhere)
    assert (found.lesson.scope.destination, found.lesson.scope.object) == ("", "soap")


def test_a_place_to_avoid_is_widened_to_other_objects_and_not_to_other_places(memory):
    strategy = Strategy(avoid_sites=("site0",))
    for item in ("tin", "soap"):
        memory.record(make_correction(item=item, place="rack", strategy=strategy, cause="PLACED_WRONG"))
    assert memory.recall(ask(make_episode(item="cube", place="rack")))
    assert not memory.recall(ask(make_episode(item="tin", place="shelf")))


PLACE = {"strategy": Strategy(avoid_sites=("site0",)), "cause": "PLACED_WRONG"}


@pytest.mark.parametrize(
    ("lesson", "case", "is_told"),
    [
        ({}, {"thing": "cube"}, False),
        ({}, {"target": "ur5e", "body": PANDA}, True),
        ({}, {"target": "ur5e", "body": msgspec.structs.replace(PANDA, grip_width_m=0.14)}, False),
        ({}, {"target": "ur5e", "body": msgspec.structs.replace(PANDA, control_period_s=0.1)}, False),
        ({}, {"target": "ur5e", "body": None}, False),
        (PLACE, {"target": "ur5e", "body": msgspec.structs.replace(PANDA, grip_width_m=0.14)}, True),
        (PLACE, {"target": "cart", "body": Embodiment(kind="base")}, False),
    ],
    ids=[
        "not of another thing", "of a hand alike", "not of a wider hand", "not of a slower hand",
        "not of a hand unknown", "of a place, for any arm", "of a place, for no base",
    ],
)  # fmt: skip
def test_a_lesson_is_told_of_the_same_object_and_a_hand_alike_or_of_a_place(memory, lesson, case, is_told):
    failed, item = teach(memory, **lesson), case.get("thing")
    asked = ask(make_episode(item=item)) if item else ask(failed, **case)
    assert bool(memory.recall(asked)) is is_told


def test_what_succeeds_anyway_needs_no_lesson(memory):
    memory.record([make_episode() for _ in range(30)])
    failed = teach(memory)
    assert memory.recall(ask(failed)) == ()


def test_a_lesson_that_later_verdicts_contradict_is_no_longer_told(memory):
    failed = teach(memory)
    id = memory.recall(ask(failed))[0].lesson.id
    memory.record([make_episode(ok=False, strategy=SLOW, advised_by=(id,)) for _ in range(4)])
    assert memory.recall(ask(failed)) == ()
    lesson = find_lesson(memory, id=id)
    assert lesson.state is EntryState.EXPIRED
    assert "contradicted" in lesson.reason


def test_of_two_corrections_the_one_that_helps_more_often_comes_first(memory):
    for ok in (True, False, False, True):
        memory.record(make_correction(ok=ok, strategy=SLOW))
    for _ in range(3):
        memory.record(make_correction(strategy=Strategy(speed=0.25)))
    first, second = memory.recall(ask(make_episode()))
    assert (first.lesson.advice, second.lesson.advice) == (Strategy(speed=0.25), SLOW)


def test_a_lesson_that_nothing_confirms_expires(memory):
    failed = teach(memory)
    correction = memory.recall(ask(failed))[0].lesson
    late = memory.experience.seq + methodological.EXPIRES_AFTER + 1
    state, reason = correction.judge(late)
    assert state is EntryState.EXPIRED
    assert "nothing confirmed it" in reason
    confirmed = msgspec.structs.replace(correction, count=correction.count.add(success=True))
    assert confirmed.judge(late)[0] is EntryState.ACTIVE, "what was confirmed twice is as short-lived"


def test_the_interval_is_wilsons():
    low, high = Count(successes=19, trials=20).interval
    assert (round(low, 3), round(high, 3)) == (0.764, 0.991)
    assert Count().interval == (0.0, 1.0)
    assert str(Count(successes=19, trials=20)) == "19 of 20 (95 % [76, 99])"
