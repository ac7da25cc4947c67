"""What the verifier knows of earlier sessions and of lessons: it reaches judges, and changes no verdict by itself."""

from dataclasses import dataclass, field, replace

import msgspec
import pytest

from phyagentos.agent.context.of_workspace import find_lessons, holds_for
from phyagentos.agent.judging.diagnosis import diagnose
from phyagentos.agent.judging.verifier import DEFAULT_JUDGES, History, SessionVerifier
from phyagentos.protocol.sessions.lessons import Lesson, render_lessons
from phyagentos.protocol.sessions.memory_entries import EntryState, Scope
from phyagentos.protocol.sessions.session import SessionStatus
from phyagentos.protocol.sessions.strategy import Strategy
from phyagentos.protocol.sessions.verdicts import Attempt, Criterion, Verdict
from phyagentos.protocol.world.truth import Truth
from phyagentos.testing import make_contract

from .conftest import make_world, put, slip
from .test_recovery_missions import achieve_unseen as leave_unseen
from .test_recovery_missions import library, still_unseen  # noqa: F401 - a fixture
from .test_verifier import AWAY, IN_TRAY, failed, make_bundle, make_session

LESSON = Lesson(
    id="lesson-slow",
    statement="Slowly it holds.",
    cause="GRASP_LOST",
    advice=Strategy(speed=0.5),
    supported=3,
    evidence=("evidence/g.red.r1",),
    scope=Scope(skill="pick_and_place", object="cube"),
)


def miss(attempt: int, cause: str, purpose: str = "") -> SessionStatus:
    contract = make_contract(id=f"g.red.r{attempt}", node="red", attempt=attempt, purpose=purpose)
    judged = Attempt(verdict=Verdict.REPLAN, criteria=(), cause=cause, reason=f"{cause} it was")
    return SessionStatus(contract=contract, state="replanned", attempts=(judged,))


HISTORY = History(
    max_replans=2, prior=(miss(0, "GRASP_MISSED"), miss(1, "GRASP_LOST"), miss(2, "GRASP_LOST")), lessons=(LESSON,)
)
BUNDLES = {
    "done": make_bundle(put(make_world(), "red_cube", IN_TRAY)),
    "elsewhere": make_bundle(put(make_world(), "red_cube", AWAY)),
    "nothing seen": make_bundle(None),
    "lost": make_bundle(put(make_world(), "red_cube", AWAY), execution=failed("GRASP_LOST")),
    "no criterion": make_bundle(make_world(), session=make_session(accept=())),
    "held wrong": make_bundle(
        put(make_world(), "red_cube", IN_TRAY),
        session=make_session(hold=("upright(bottle)",)),
        holds=(Criterion(text="upright(bottle)", kind="hold", truth=Truth.FALSE, because="it fell"),),
    ),
}


@pytest.mark.parametrize("bundle", BUNDLES.values(), ids=BUNDLES)
@pytest.mark.parametrize("mode", ["recovery", "enforce", "audit"])
def test_history_changes_no_bit_of_a_judgement(bundle, mode):
    verifier = SessionVerifier(mode=mode)
    blank = replace(HISTORY, prior=(), lessons=())
    assert msgspec.json.encode(verifier.judge(bundle, HISTORY)) == msgspec.json.encode(verifier.judge(bundle, blank))


@dataclass
class Witness:
    """Says nothing, and remembers what it was shown."""

    name: str = "witness/1"
    seen: dict = field(default_factory=dict)

    def judge(self, bundle):
        self.seen[bundle.session.id] = (bundle.prior, bundle.lessons)
        return []


class Forgetful(SessionVerifier):
    """Judges without what was before."""

    def judge(self, bundle, history):
        return super().judge(bundle, replace(history, prior=(), lessons=()))


def pursue(stage, graph, verifier, lessons=(LESSON,)):
    if lessons:
        stage.workspace.lessons.write_text(render_lessons(lessons))
    mission = stage.make_mission(verifier=verifier)
    mission.run(graph, seed=7)
    return mission.ledger


def test_judges_of_a_mission_see_the_earlier_sessions_of_the_node_and_the_lessons_in_force(make_stage, two):
    witness = Witness()
    others = msgspec.structs.replace(LESSON, id="lesson-other", scope=Scope(skill="push"))
    retracted = msgspec.structs.replace(LESSON, id="lesson-old", state=EntryState.RETRACTED, reason="other fingers")
    script = {"red": slip, "red.r1": slip}
    verifier = SessionVerifier(judges=(*DEFAULT_JUDGES, witness))
    ledger = pursue(make_stage(script), two, verifier, (LESSON, others, retracted))

    assert list(witness.seen) == ["two-7.green", "two-7.red", "two-7.red.r1", "two-7.red.r2"]
    assert [lessons for _, lessons in witness.seen.values()] == [(LESSON,)] * 4
    prior = {id: [each.contract.id for each in prior] for id, (prior, _) in witness.seen.items()}
    assert prior["two-7.green"] == prior["two-7.red"] == []
    assert prior["two-7.red.r2"] == ["two-7.red", "two-7.red.r1"]
    before, last = witness.seen["two-7.red.r2"][0]
    assert (before.decision.cause, last.decision.verdict) == ("GRASP_LOST", Verdict.REPLAN)
    assert last.decision == ledger.sessions["two-7.red.r1"].decision


@pytest.mark.parametrize("script", [{"red": slip, "red.r1": slip}, {"red": leave_unseen, "red.r1": still_unseen}])
def test_a_mission_judges_alike_bit_for_bit_with_and_without_history(make_stage, two, tmp_path, script):
    found = []
    for verifier, lessons in ((SessionVerifier(), (LESSON,)), (Forgetful(), ())):
        stage = make_stage(script)
        ledger = pursue(stage, two, verifier, lessons)
        found.append({id: (each.state, msgspec.json.encode(each.attempts)) for id, each in ledger.sessions.items()})
        stage.close()
        stage.workspace.root.rename(tmp_path / f"over{len(found)}")
    assert found[0] == found[1]
    assert len(found[0]) > 2


def test_a_diagnosis_says_how_often_in_a_row_its_cause_has_come_back():
    bundle = make_bundle(put(make_world(), "red_cube", AWAY), execution=failed("GRASP_LOST"))
    criteria = SessionVerifier().judge(bundle, HISTORY).criteria
    assert diagnose(bundle, criteria).repeats == 0
    look = miss(3, "EVIDENCE_MISSING", purpose="inspect")  # it pursued something else
    known = msgspec.structs.replace(bundle, prior=(*HISTORY.prior, look))
    found = diagnose(known, criteria)
    assert (found.cause, found.repeats) == ("GRASP_LOST", 2)
    assert diagnose(msgspec.structs.replace(bundle, prior=(miss(0, "NO_PLAN"),)), criteria).repeats == 0


@pytest.mark.parametrize(
    ("scope", "holds"),
    [
        (Scope(), True),
        (Scope(scene="s", skill="pick_and_place", target="panda", object="cube", destination="tray"), True),
        (Scope(scene="elsewhere"), False),
        (Scope(skill="push"), False),
        (Scope(target="ur5e"), False),
        (Scope(object="bottle"), False),
        (Scope(destination="region"), False),
        (Scope(entities=("red_cube",)), True),
        (Scope(entities=("bottle",)), False),
    ],
)
def test_a_lesson_is_in_force_where_its_scope_does_not_exclude_the_session(scope, holds):
    assert holds_for(scope, make_session(), make_world()) is holds


def test_lessons_are_read_again_when_they_change_and_are_none_while_they_cannot_be_read(tmp_path):
    path = tmp_path / "LESSONS.md"
    session, world = make_session(), make_world()
    assert find_lessons(path, session, world) == ()
    path.write_text(render_lessons([LESSON]))
    assert find_lessons(path, session, world) == (LESSON,)
    path.write_text(render_lessons([msgspec.structs.replace(LESSON, state=EntryState.EXPIRED, reason="long ago")]))
    assert find_lessons(path, session, world) == ()
    path.write_text("no document at all")
    assert find_lessons(path, session, world) == ()
