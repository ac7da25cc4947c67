"""`paos verify`: a judgement is added to a session that has its verdict; none is erased, no state changes."""

import hashlib
import json

import msgspec
import pytest

from phyagentos.cli.outcome import ExitCode
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.sessions.evidence import AFTER, BEFORE, write_json
from phyagentos.protocol.sessions.lifecycle import IllegalTransition, Side
from phyagentos.protocol.sessions.verdicts import Verdict
from phyagentos.protocol.world.environment import Entity, Environment, Interior, Pose, Shape, ShapeKind
from phyagentos.protocol.world.truth import Truth
from phyagentos.store.journal import Entry
from phyagentos.store.views.sessions import build_page, render_page
from tests.command_line import assert_ended, assert_refused

SESSION = "tidy-7.red"
IN_TRAY, AWAY = (0.6, 0.3, 0.03), (0.4, 0.0, 0.02)


def make_world(position, time_s):
    cube = Entity(
        name="red_cube",
        kind="cube",
        pose=Pose(position),
        shapes=(Shape(ShapeKind.BOX, (0.02, 0.02, 0.02)),),
        observed_at_s=time_s,
    )
    tray = Entity(
        name="red_tray",
        kind="tray",
        pose=Pose((0.6, 0.3, 0.0)),
        movable=False,
        interior=Interior((0, 0, 0.035), (0.09, 0.07, 0.025)),
    )
    entities = {"red_cube": cube, "red_tray": tray}
    return Environment(time_s=time_s, scene="s", episode="e", revision=1, sensing="truth", entities=entities)


@pytest.fixture
def judged(run):
    """A session that failed, and whose evidence shows that it did what it should."""
    run.begin()
    id = run.submit("red")
    run.execute(id)
    run.judge(id, Verdict.FAILURE, Truth.FALSE)
    folder = run.workspace.evidence_of(id)
    folder.mkdir()
    write_json(folder / BEFORE, make_world(AWAY, 0.0))
    write_json(folder / AFTER, make_world(IN_TRAY, 9.0))
    return run


def fold(run):
    return read_ledger(run.workspace.root).sessions[SESSION]


def test_a_judgement_is_added_and_the_verdict_stays(paos, judged):
    before = fold(judged)
    assert_ended(
        paos("verify", "red", "-w", judged.workspace.root, "--with", "predicates,holds"),
        ExitCode.GOAL_MET,
        out=[f"{SESSION}: success  the criterion holds", "added as judgement 2; the verdict stays failure"],
    )
    after = fold(judged)
    assert (after.state, after.updated_at, after.attempts[0]) == (before.state, before.updated_at, before.attempts[0])
    added = after.attempts[1]
    assert (added.verdict, added.is_review, added.judges) == ("success", True, ("predicates/2", "holds/2"))
    data = (judged.workspace.evidence_of(SESSION) / AFTER).read_bytes()
    assert {r.file: r.sha256 for r in added.evidence}[AFTER] == hashlib.sha256(data).hexdigest()
    assert after.decision == before.attempts[0]


def test_every_further_judgement_is_appended(paos, judged):
    for _ in range(2):
        paos("verify", SESSION, "-w", judged.workspace.root)
    result = paos("verify", SESSION, "-w", judged.workspace.root, "--mode", "audit", "--json")
    assert result.code == ExitCode.GOAL_NOT_MET  # it ended `skill_failed`, and in an audit that decides
    assert json.loads(result.out)["judgement"]["found"] == "success"
    status = fold(judged)
    assert [attempt.is_review for attempt in status.attempts] == [False, True, True, True]
    assert [attempt.mode for attempt in status.attempts] == ["recovery", "enforce", "enforce", "audit"]


def test_evidence_that_changed_since_is_seen_in_its_hash(paos, judged):
    paos("verify", SESSION, "-w", judged.workspace.root)
    write_json(judged.workspace.evidence_of(SESSION) / AFTER, make_world(AWAY, 9.0))
    assert paos("verify", SESSION, "-w", judged.workspace.root).code == ExitCode.GOAL_NOT_MET
    hashes = [{r.file: r.sha256 for r in attempt.evidence} for attempt in fold(judged).attempts[1:]]
    assert hashes[0][AFTER] != hashes[1][AFTER]
    assert hashes[0][BEFORE] == hashes[1][BEFORE]


def test_everybody_sees_the_verdict_and_every_judgement(paos, judged):
    paos("verify", SESSION, "-w", judged.workspace.root)
    page = render_page(build_page(read_ledger(judged.workspace.root)))
    assert f"| {SESSION} | failed | failure |" in page
    assert "is_review: true" in page
    told = paos("why", SESSION, "-w", judged.workspace.root)
    assert "  verdict     failure, sensing truth" in told.out
    assert "  review      success, sensing truth" in told.out


def test_a_session_without_a_verdict_is_refused(paos, run):
    run.begin()
    run.execute(run.submit("red"))
    assert_refused(
        paos("verify", SESSION, "-w", run.workspace.root),
        "NOT_EXECUTED: found state awaiting_verification",
        "'paos judge' judges what waits for a verdict",
    )


def test_a_judge_that_nobody_knows_is_refused_with_the_nearest_name(paos, judged):
    assert_refused(
        paos("verify", SESSION, "-w", judged.workspace.root, "--with", "predicate"),
        "UNKNOWN_NAME (judge): found 'predicate'",
        "Did you mean 'predicates'?",
    )


def test_a_model_is_asked_only_when_it_is_configured(paos, judged):
    assert_refused(paos("verify", SESSION, "-w", judged.workspace.root, "--with", "vision"), "EXTRA_MISSING")
    assert len(fold(judged).attempts) == 1


@pytest.mark.parametrize("side", [Side.RUNTIME, Side.OPERATOR])
def test_only_the_agent_may_review(judged, side):
    with pytest.raises(IllegalTransition, match=f"{side} asked for 'review' in state 'failed'"):
        judged.write(side, SESSION, "review", None)


def test_a_review_that_does_not_say_that_it_is_one_is_refused(judged):
    attempt = msgspec.to_builtins(fold(judged).attempts[0])
    with pytest.raises(Exception, match="no attempt with is_review"):
        judged.pens[Side.AGENT].commit([Entry(SESSION, "review", {"attempt": attempt})])


def test_a_session_that_left_no_frames_is_not_judged_from_them(paos, judged):
    result = paos("verify", SESSION, "-w", judged.workspace.root, "--from-frames")
    assert result.code not in (ExitCode.GOAL_MET, ExitCode.GOAL_NOT_MET)
    assert "looks.json: no look was recorded" in result.err
    assert len(fold(judged).attempts) == 1
