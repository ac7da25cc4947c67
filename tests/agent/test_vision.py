"""The judge that looks at pictures, against a server that speaks the protocol over a real socket."""

import base64
import hashlib

import msgspec
import pytest
import yaml

from phyagentos.agent.judging.judges.vision import VisionJudge
from phyagentos.agent.judging.verifier import SessionVerifier
from phyagentos.assembly.verification import build_verifier
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.network.chat import MAX_BYTES, OpenAiEndpoint
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.documents.document import iter_blocks
from phyagentos.protocol.sessions.evidence import PICTURE_AFTER, PICTURE_BEFORE
from phyagentos.protocol.sessions.evidence_manifest import Sealer, check_bundle, get_shown_name
from phyagentos.protocol.sessions.looks import LookRole
from phyagentos.protocol.sessions.verdicts import EvidenceReference, Verdict
from phyagentos.protocol.settings.verification import JudgeName
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.truth import Truth
from tests.hostile_server import HostileServer
from tests.looks import keep_look

from .test_context import HOSTILE
from .test_history import HISTORY
from .test_verifier import BUDGET, DONE, make_bundle, make_session

YES = '{"truth": "true", "because": "the cube lies between the walls"}'


@pytest.fixture
def bundle(tmp_path):
    for role, shown in ((LookRole.START, "before"), (LookRole.END, "after")):
        keep_look(tmp_path, role, {name: f"{name} {shown}".encode() for name in ("top", "left")})
    for name in (PICTURE_BEFORE, PICTURE_AFTER):
        (tmp_path / name).write_bytes(b"a rendering")
    return make_bundle(DONE, folder=tmp_path)


def _decode(url):
    return base64.b64decode(url.removeprefix("data:image/png;base64,")).decode()


def make_judge(url, *, key="", timeout_s=5.0, **more):
    endpoint = OpenAiEndpoint(url=url, model="looker-1", key=key, timeout_s=timeout_s)
    return VisionJudge(endpoint, **more)


def test_it_is_shown_what_the_cameras_saw_and_no_rendering_and_a_strict_answer_is_believed(serve, bundle):
    model = serve(YES)
    (criterion,) = make_judge(model.url, key="secret").judge(bundle)
    assert (criterion.text, criterion.kind, criterion.truth) == ("inside(red_cube, red_tray)", "vision", Truth.TRUE)
    assert criterion.because == "the cube lies between the walls"
    (asked,) = model.asked
    assert (asked["path"], asked["model"], asked["temperature"]) == ("/v1/chat/completions", "looker-1", 0)
    text, *shown = asked["messages"][1]["content"]
    assert '\nstatement: "inside(red_cube, red_tray)"\n' in text["text"]
    assert "inside(a, b) means: Let go of; centre and datum within the sides of the interior" in text["text"]
    sent = [each.get("text") or _decode(each["image_url"]["url"]) for each in shown]
    before, after = (["top before", "left before"], ["top after", "left after"])
    assert sent == ["Before the task:", *before, "After the task:", *after]
    assert model.keys[0] == "Bearer secret"


@pytest.mark.parametrize(("said", "truth"), [("false", Truth.FALSE), ("unknown", Truth.UNKNOWN)])
def test_its_answer_is_weighed_like_any_other(serve, bundle, said, truth):
    model = serve({"truth": said, "because": "so it looks"})
    verifier = SessionVerifier(costly=(make_judge(model.url),))
    attempt = verifier.judge(bundle, BUDGET)
    assert attempt.verdict is not Verdict.SUCCESS
    assert attempt.criteria[-1].truth is truth
    assert "look-end.zip" in {reference.file for reference in attempt.evidence}
    assert attempt.judges[-1] == "vision/3(looker-1 at 127.0.0.1)"
    assert "secret" not in repr(verifier)


@pytest.mark.parametrize(
    ("facts", "because"),
    [
        *(
            ({"answer": answer}, "MODEL_FAILED")
            for answer in (
                "Yes, it is.",
                '```json\n{"truth": "true", "because": "x"}\n```',
                '{"truth": "probably", "because": "x"}',
                '{"truth": "true"}',
                '{"truth": "true", "because": "x", "score": 0.9}',
            )
        ),
        *(({"body": body}, "MODEL_FAILED") for body in (b"{}", b"\xff\xfe")),
        ({"body": b"[" * (MAX_BYTES + 1)}, "MODEL_FAILED: looker-1 at 127.0.0.1 answered with more than"),
        ({"status": 500}, "MODEL_FAILED: looker-1 at 127.0.0.1 answered with status 500"),
        ({"status": 302}, "MODEL_FAILED: looker-1 at 127.0.0.1 answered with status 302"),
    ],
)
def test_an_answer_of_another_form_than_the_one_asked_for_is_unknown(serve, bundle, facts, because):
    model = serve(facts.pop("answer", YES), **facts)
    (criterion,) = make_judge(model.url).judge(bundle)
    assert (criterion.truth, because in criterion.because) == (Truth.UNKNOWN, True)
    assert len(model.asked) == 1  # nothing is followed, nothing is tried again


def test_a_server_cannot_hold_a_judge(bundle):
    hostile = HostileServer("a drip of headers")
    (criterion,) = make_judge(hostile.url, timeout_s=0.2).judge(bundle)
    hostile.close()
    assert (criterion.truth, criterion.because.split(":")[0]) == (Truth.UNKNOWN, "MODEL_FAILED")
    assert "in 0.2 s" in criterion.because


@pytest.mark.parametrize("missing", ["look-start.zip", "look-end.zip", "looks.json"])
def test_without_frames_no_model_is_asked(serve, bundle, missing):
    model = serve(YES)
    (bundle.folder / missing).unlink()
    (criterion,) = make_judge(model.url).judge(bundle)
    assert (criterion.truth, criterion.because.split(":")[0]) == (Truth.UNKNOWN, "EVIDENCE_DAMAGED")
    assert model.asked == []


def test_without_a_server_it_is_unknown(serve, bundle):
    gone = serve(YES)
    gone.close()
    (criterion,) = make_judge(gone.url).judge(bundle)
    assert (criterion.truth, criterion.because.split(":")[0]) == (Truth.UNKNOWN, "MODEL_FAILED")


def test_the_same_question_about_the_same_pictures_is_asked_once(serve, bundle):
    model = serve(YES)
    judge = make_judge(model.url)
    assert judge.judge(bundle) == judge.judge(bundle)
    assert len(model.asked) == 1


def test_what_was_shown_stands_in_the_sealed_bundle_and_the_judgement_names_its_hash(serve, tmp_path):
    folder = tmp_path / "evidence" / "g.red"
    folder.mkdir(parents=True)
    for role in (LookRole.START, LookRole.END):
        keep_look(folder, role, {"top": role.encode()})
    Sealer(folder.parent).seal(folder)
    model = serve(YES)
    verifier = SessionVerifier(costly=(make_judge(model.url),))
    attempt = verifier.judge(make_bundle(DONE, folder=folder), HISTORY)

    (asked,) = model.asked
    sent = asked["messages"][1]["content"][0]["text"]
    sha256 = attempt.criteria[-1].shown
    kept = folder / get_shown_name(sha256)
    assert kept.read_text() == sent
    assert hashlib.sha256(kept.read_bytes()).hexdigest() == sha256
    assert EvidenceReference(file=get_shown_name(sha256), sha256=sha256) in attempt.evidence
    assert "shown" not in msgspec.to_builtins(attempt.criteria[0])  # no model was asked

    found = {block.name: yaml.safe_load(block.yaml) for block in iter_blocks(sent)}
    assert list(found) == ["question", "request", "attempts", "lessons"]
    question = found["question"]
    assert question["statement"] == "inside(red_cube, red_tray)"
    pictures = [hashlib.sha256(shown).hexdigest() for shown in (b"start", b"end")]
    assert (question["before"], question["after"]) == ([pictures[0]], [pictures[1]])
    causes = [(id, each["cause"], each["reason"]) for id, each in found["attempts"].items()]
    assert causes == [
        ("g.red.r2", "GRASP_LOST", "GRASP_LOST it was"),
        ("g.red.r1", "GRASP_LOST", "GRASP_LOST it was"),
        ("g.red.r0", "GRASP_MISSED", "GRASP_MISSED it was"),
    ]
    assert found["lessons"]["lesson-slow"]["evidence"] == ["evidence/g.red.r1"]

    assert check_bundle(folder, [sha256]) == []
    kept.write_text(sent.replace("GRASP_LOST", "SUCCESS"))
    assert [problem.found[:7] for problem in check_bundle(folder)] == ["sha256 "]
    kept.unlink()
    assert [problem.found for problem in check_bundle(folder, [sha256])] == ["no such file"]


@pytest.mark.parametrize("hostile", HOSTILE)
def test_texts_of_others_reach_the_model_as_values_only(serve, bundle, hostile):
    model = serve(YES)
    session = make_session(objective=hostile)
    (before,) = (msgspec.structs.replace(each, reason=hostile) for each in HISTORY.prior[-1].attempts)
    prior = (msgspec.structs.replace(HISTORY.prior[-1], attempts=(before,)),)
    shown = msgspec.structs.replace(bundle, session=session, prior=prior)
    (criterion,) = make_judge(model.url).judge(shown)
    assert criterion.truth is Truth.TRUE
    blocks = list(iter_blocks(model.asked[0]["messages"][1]["content"][0]["text"]))
    assert [block.name for block in blocks] == ["question", "request", "attempts"]
    assert yaml.safe_load(blocks[1].yaml)["g.red"]["objective"] == hostile
    assert yaml.safe_load(blocks[2].yaml)["g.red.r2"]["reason"] == hostile


def test_no_model_is_asked_what_cannot_be_kept_or_is_too_long(serve, bundle):
    model = serve(YES)
    (bundle.folder / "shown").write_text("no folder")
    (criterion,) = make_judge(model.url).judge(bundle)
    assert (criterion.truth, criterion.failure) == (Truth.UNKNOWN, "WRITE_FAILED")
    (bundle.folder / "shown").unlink()
    long = msgspec.structs.replace(bundle, session=make_session(accept=("visible(red_cube) and " * 600 + "true",)))
    (criterion,) = make_judge(model.url).judge(long)
    assert (criterion.truth, criterion.failure) == (Truth.UNKNOWN, "TOO_LARGE")
    assert model.asked == []


def test_only_so_many_criteria_are_asked_about(serve, tmp_path, bundle):
    texts = tuple(f"at(red_cube, red_tray, 0.{n})" for n in range(1, 4))
    many = make_bundle(DONE, folder=bundle.folder, session=make_session(accept=texts))
    model = serve(YES)
    criteria = make_judge(model.url, max_questions=2).judge(many)
    assert [criterion.truth for criterion in criteria] == ["true", "true", "unknown"]
    assert len(model.asked) == 2


@pytest.fixture
def workspace(tmp_path):
    return Workspace.create(tmp_path / "w", Library.open())


def configure(workspace, text):
    path = workspace.runtime_contract
    path.write_text(path.read_text().split("verification:")[0] + text)


def test_nobody_is_asked_unless_it_is_configured(workspace, serve, bundle, monkeypatch):
    model = serve(YES)
    monkeypatch.setenv("OPENAI_BASE_URL", model.url)
    monkeypatch.setenv("OPENAI_API_KEY", "secret")
    verifier = build_verifier(workspace, SystemClock())
    assert verifier.costly == []
    assert verifier.judge(bundle, BUDGET).verdict is Verdict.SUCCESS
    assert model.asked == []


def test_asking_a_model_that_is_not_configured_is_an_error_that_says_what_to_write(workspace):
    with pytest.raises(DefinitionError, match=r"EXTRA_MISSING.*Write 'vision: \{url"):
        build_verifier(workspace, SystemClock(), judges=(JudgeName.VISION,))


def test_the_key_comes_from_the_variable_that_the_settings_name(workspace, serve, bundle, monkeypatch):
    model = serve(YES)
    configure(
        workspace,
        "verification:\n  judges: [predicates, vision]\n"
        f"  vision: {{url: '{model.url}', model: looker-1, api_key_env: LOOKER_KEY, timeout_s: 5}}\n",
    )
    monkeypatch.delenv("LOOKER_KEY", raising=False)
    with pytest.raises(DefinitionError, match=r"EXTRA_MISSING.*environment variable LOOKER_KEY is not set"):
        build_verifier(workspace, SystemClock())
    monkeypatch.setenv("LOOKER_KEY", "secret")
    attempt = build_verifier(workspace, SystemClock()).judge(bundle, BUDGET)
    assert attempt.verdict is Verdict.SUCCESS
    assert [criterion.kind for criterion in attempt.criteria] == ["accept", "vision"]
    assert model.keys[0] == "Bearer secret"


def test_settings_that_cannot_be_meant_are_refused(workspace):
    for text, message in (
        ("verification: {judges: [vision]}\n", "the judge 'vision' needs a block 'vision'"),
        ("verification: {judges: [predicates], criteria: ['metric(ticks) <= 9']}\n", "not among the judges"),
        ("verification: {criteria: ['metric(ticks)']}\n", "INVALID_VALUE"),
        ("verification: {mode: sometimes}\n", "recovery"),
        ("verification: {vision: {url: 'ftp://x', model: m}}\n", "https"),
    ):
        configure(workspace, text)
        with pytest.raises(DefinitionError, match=message):
            build_verifier(workspace, SystemClock())
