"""Lessons about the contract itself: another skill, target or parameter, and what has to come first."""

from msgspec.structs import replace

from phyagentos.agent.memory.episodes import Features
from phyagentos.agent.memory.scopes import find_mismatch
from phyagentos.protocol.sessions.means import Means, Preparation
from phyagentos.protocol.sessions.memory_entries import Embodiment, EntryState
from phyagentos.protocol.sessions.strategy import DEFAULT_STRATEGY

from .conftest import ask, make_episode

ASIDE = Preparation(purpose="clear", skill="set_aside", kind="post")
HEMMED = {"item": "cube", "cause": "NO_PLAN", "parameters": {"object": "cube_1", "destination": "tray_1"}}


def make_cleared(*, ok=True):
    """A failure, an object that is set aside, and the same attempt again."""
    failed = make_episode(ok=False, **HEMMED)
    post = Features(object="post_1", object_kind="post")
    clear = make_episode(
        parent=failed, session="c", purpose="clear", skill="set_aside", features=post, parameters={"object": "post_1"}
    )
    clear = replace(clear, features=post)
    return [failed, clear, make_episode(ok=ok, parent=replace(failed, session="c"), parameters=HEMMED["parameters"])]


def learn(memory, *events):
    memory.record(events)
    (lesson,) = (each for each in memory.experience.corrections.values() if each.scope.scene)
    return lesson


def test_a_success_by_another_skill_teaches_that_skill_where_the_first_one_failed(memory):
    failed = make_episode(ok=False, cause="IMPOSSIBLE", item="carton")
    lesson = learn(memory, failed, make_episode(parent=failed, skill="push", strategy=DEFAULT_STRATEGY))
    assert (lesson.means, lesson.scope.skill) == (Means(skill="push"), "pick_and_place")
    (found,) = memory.recall(ask(failed))
    assert found.lesson.id == lesson.id


def test_what_only_resumes_with_the_object_in_the_hand_teaches_no_other_skill(memory):
    failed = make_episode(ok=False)
    memory.record([failed, make_episode(parent=failed, skill="place", resumes=True)])
    assert memory.experience.corrections == {}


def test_a_success_on_another_target_and_with_other_values_teaches_both(memory):
    failed = make_episode(ok=False, cause="STALLED", parameters={"object": "soap_1", "near": [0, 0, 0]})
    child = make_episode(parent=failed, parameters={"object": "soap_1", "near": [0.1, 0, 0]})
    lesson = learn(memory, failed, replace(child, target="left"))
    assert lesson.means == Means(target="left", parameters={"near": [0.1, 0, 0]})


def test_what_was_cleared_before_the_success_comes_first_from_then_on(memory):
    lesson = learn(memory, *make_cleared())
    assert lesson.means == Means(prepare=(ASIDE,))
    (entry,) = memory.experience.list_lessons()
    assert "set_aside of a post first helps" in entry.statement
    assert (entry.state, entry.means) == (EntryState.ACTIVE, lesson.means)


def test_what_was_cleared_in_vain_is_never_advised(memory):
    failed, *rest = make_cleared(ok=False)
    memory.record([failed, *rest])
    assert memory.recall(ask(failed)) == ()


def test_a_preparation_that_failed_is_not_learned(memory):
    failed, clear, again = make_cleared()
    memory.record([failed, replace(clear, verdict="replan"), again])
    assert memory.experience.corrections == {}


def test_a_first_attempt_that_memory_prepared_counts_for_the_lesson_and_not_for_the_own_way(memory):
    failed, *rest = make_cleared()
    lesson = learn(memory, failed, *rest)
    before = memory.experience.find_baseline(lesson)
    advised = {"parent": "g9.n", "prepared": True, "advised_by": (lesson.id,), "session": "g9.n.r1"}
    memory.record([replace(make_episode(**HEMMED), **advised)])
    counted = memory.experience.corrections[lesson.id]
    assert (counted.applied.successes, counted.applied.trials) == (1, 1)
    assert memory.experience.find_baseline(lesson) == before
    assert all(not each.count.successes for each in memory.experience.patterns.values())


def test_a_session_of_another_run_with_the_same_id_corrects_nothing(memory):
    failed, clear, again = make_cleared()
    memory.record([failed, clear, again])
    before = dict(memory.experience.corrections)
    memory.record([replace(each, begun="later", judged_at="later") for each in (clear, again)])
    assert memory.experience.corrections == before


GAME = {
    "scene": "wilds",
    "skill": "make",
    "target": "survivor",
    "body": Embodiment(kind="agent"),
    "features": Features(),
    "parameters": {"what": "pickaxe"},
}


def test_what_a_game_taught_without_any_object_advises_there_on_every_seed_and_no_arm(memory):
    failed = make_episode(ok=False, cause="UNKNOWN", **GAME)
    child = make_episode(parent=failed, **GAME | {"skill": "build_and_make"})
    lesson = learn(memory, failed, child)
    assert lesson.means == Means(skill="build_and_make")
    assert [each.lesson.id for each in memory.recall(ask(make_episode(seed=99, **GAME)))] == [lesson.id]
    assert memory.recall(ask(make_episode())) == ()
    wide = replace(lesson.where, skill="", scene="")
    assert find_mismatch(wide, ask(make_episode()), DEFAULT_STRATEGY) == "learned with a body of kind agent, not arm"
