"""The records are the truth; everything beside them may be lost."""

import shutil

import msgspec
import pytest

from phyagentos.agent.memory import experience
from phyagentos.agent.memory.experience import Experience
from phyagentos.agent.memory.experience_log import Edit
from phyagentos.agent.memory.memory import Retrieval
from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.memory_entries import EntryState, Scope

from .conftest import SLOW, ask, make_correction, make_episode, teach


def encode(memory):
    return msgspec.json.encode(memory.experience, order="deterministic")


def find_segment(tmp_path):
    return next((tmp_path / "memory").glob("*/*.md"))


def find_cache(tmp_path):
    return next((tmp_path / ".cache").glob("memory-*.json"))


def test_a_deleted_cache_loses_nothing(memory, open_memory, tmp_path):
    failed, corrected = make_correction()
    memory.record([failed, corrected, *(make_episode() for _ in range(20))])
    shutil.rmtree(tmp_path / ".cache")
    again = open_memory()
    assert encode(again) == encode(memory)
    assert again.recall(ask(failed)) == memory.recall(ask(failed))
    assert again.version == memory.version


@pytest.mark.parametrize("damage", [b"", b"no JSON at all", b"{}", bytes(200)])
def test_a_damaged_cache_is_made_anew(memory, open_memory, tmp_path, damage):
    failed = teach(memory)
    find_cache(tmp_path).write_bytes(damage)
    assert open_memory().recall(ask(failed))


def test_a_number_that_rotted_in_the_cache_is_counted_anew(memory, open_memory, tmp_path):
    memory.record(make_correction())
    cache = find_cache(tmp_path)
    rotten = cache.read_bytes().replace(b'"successes":1', b'"successes":9')
    assert rotten != cache.read_bytes()
    cache.write_bytes(rotten)
    assert encode(open_memory()) == encode(memory)


def test_a_cache_of_other_records_is_not_believed(memory, open_memory, tmp_path):
    failed = teach(memory)
    shutil.rmtree(tmp_path / "memory")
    emptied = open_memory()
    assert emptied.recall(ask(failed)) == ()
    assert emptied.version.startswith("memory/0-")
    emptied.record([make_episode(item="cube")])
    assert open_memory().recall(ask(failed)) == ()


def test_what_is_recorded_bit_by_bit_is_known_as_what_is_recorded_at_once(open_memory):
    events = [event for item in ("soap", "tin", "cube") for event in (*make_correction(item=item), make_episode())]
    one, all_at_once = open_memory("one"), open_memory("other")
    for event in events:
        one.record([event])
    all_at_once.record(events)
    assert encode(one) == encode(all_at_once)


def test_a_torn_tail_is_cut_and_what_was_told_stands(memory, open_memory, tmp_path):
    failed, corrected = make_correction()
    memory.record([failed])
    with find_segment(tmp_path).open("ab") as file:
        file.write(b"<!-- phy1 00000000")
    again = open_memory()
    again.record([corrected])
    assert open_memory().recall(ask(failed))


def test_a_changed_record_is_noticed(memory, open_memory, tmp_path):
    memory.record(make_correction(ok=False))
    shutil.rmtree(tmp_path / ".cache")
    segment = find_segment(tmp_path)
    forged = segment.read_bytes().replace(b'"verdict":"replan"', b'"verdict":"succes"')
    segment.write_bytes(forged)
    with pytest.raises(ExecutionError, match="JOURNAL_DAMAGED"):
        open_memory()


def test_two_writers_take_turns(open_memory):
    one, other = open_memory(), open_memory()
    failed, corrected = make_correction()
    one.record([failed])
    other.record([corrected])
    one.refresh()
    assert one.recall(ask(failed))
    assert encode(one) == encode(other)


def test_what_is_forgotten_is_kept_with_the_reason_and_used_no_more(memory, open_memory):
    failed = teach(memory)
    id = memory.recall(ask(failed))[0].lesson.id
    memory.record([Edit(entry=id, retracts=True, reason="the soap was replaced", by="a person")])
    memory.record(make_correction())  # later verdicts do not raise it again
    again = open_memory()
    assert id not in {each.lesson.id for each in again.recall(ask(failed))}
    lesson = next(each for each in again.experience.list_lessons() if each.id == id)
    assert (lesson.state, lesson.reason) == (EntryState.RETRACTED, "the soap was replaced")
    assert len(again.read_all()) == 5


def test_a_person_may_say_where_a_lesson_holds(memory):
    failed = teach(memory)
    id = memory.recall(ask(failed))[0].lesson.id
    wider = Scope(skill="pick_and_place", target="panda", object="soap")
    memory.record([Edit(entry=id, scope=wider, by="a person")])
    assert memory.recall(ask(make_episode(place="shelf")))
    narrower = Scope(skill="pick_and_place", target="panda", object="soap", scene="elsewhere")
    memory.record([Edit(entry=id, scope=narrower, by="a person")])
    assert memory.recall(ask(failed)) == ()


def test_words_find_lessons_for_people(memory):
    memory.record([*make_correction(item="soap"), *make_correction(item="tin", place="rack")])
    assert {each.scope.object for each in memory.search("rack")} == {"tin"}
    assert memory.search('" OR') == ()


def test_it_stays_small_however_much_is_remembered(monkeypatch):
    monkeypatch.setattr(experience, "CORRECTIONS_KEPT", 20)
    monkeypatch.setattr(experience, "PATTERNS_KEPT", 20)
    monkeypatch.setattr(experience, "FAILURES_KEPT", 20)
    monkeypatch.setattr(experience, "SESSIONS_KEPT", 20)
    monkeypatch.setattr(experience, "ENTRIES_MAX", 10)
    known = Experience()
    events = [event for number in range(100) for event in make_correction(item=f"thing{number}")]
    known.extend(enumerate(events, 1))
    sizes = [len(each) for each in (known.corrections, known.patterns, known.failures, known.known)]
    assert max(sizes) <= 20
    assert any(lesson.scope.object == "thing99" for lesson in known.corrections.values())
    assert len(known.list_lessons()) == len(known.list_facts()) == 10


def test_a_flood_of_what_was_tried_once_drives_out_nothing_that_was_confirmed(monkeypatch):
    monkeypatch.setattr(experience, "CORRECTIONS_KEPT", 40)
    known = Experience()
    confirmed = make_correction(item="soap") + make_correction(item="soap")
    noise = [each for number in range(200) for each in make_correction(item=f"thing{number}", ok=number % 2 == 0)]
    known.extend(enumerate(confirmed + noise, 1))
    assert len(known.corrections) <= 40
    assert Retrieval(known).recall(ask(confirmed[0]))
    newest = make_correction(item="tin")
    known.extend(enumerate(newest, known.seq + 1))
    assert Retrieval(known).recall(ask(newest[0])), "what is new was not even tried"


def test_a_retracted_lesson_is_not_let_go(monkeypatch):
    monkeypatch.setattr(experience, "CORRECTIONS_KEPT", 10)
    known = Experience()
    known.extend(enumerate(make_correction(item="first"), 1))
    retracted = next(iter(known.corrections))
    known.extend([(3, Edit(entry=retracted, retracts=True, reason="wrong"))])
    events = [event for number in range(30) for event in make_correction(item=f"thing{number}")]
    known.extend(enumerate(events, 4))
    assert known.corrections[retracted].state is EntryState.RETRACTED


def test_sessions_of_one_name_from_two_workspaces_are_two_and_one_that_is_told_twice_is_one(memory):
    first = make_episode(judged_at="2026-01-01T10:00:00.000Z")
    other = msgspec.structs.replace(first, judged_at="2026-01-02T10:00:00.000Z", seed=first.seed + 1)
    memory.record([first, other, first])
    assert sum(pattern.count.trials for pattern in memory.experience.patterns.values()) == 2


def test_a_snapshot_answers_as_it_did_however_much_is_recorded_later(memory, open_memory):
    failed = teach(memory)
    snapshot, said = memory.snapshot, memory.recall(ask(failed))
    assert open_memory().snapshot == snapshot
    for _ in range(5):
        memory.record([make_episode(ok=False, strategy=SLOW, advised_by=(said[0].lesson.id,))])
    assert memory.recall(ask(failed)) == ()
    assert memory.look_back(snapshot).recall(ask(failed)) == said
    assert memory.look_back(snapshot[:-1] + "x") is None
