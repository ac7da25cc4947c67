"""Every judge that ships or is installed: named with a version, repeatable, reading only, failing closed."""

from pathlib import Path

import pytest

from phyagentos.agent.judging.judges.judge_registry import JudgeSettings
from phyagentos.assembly.verification import JUDGES
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.evidence import HOLDS, TRAJECTORY, Bundle
from phyagentos.protocol.sessions.lookahead import LOOKAHEAD
from phyagentos.protocol.sessions.looks import LOOKS
from phyagentos.protocol.sessions.session import Ended, Execution
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.settings.verification import Verification
from phyagentos.protocol.world.environment import Entity, Environment, Interior, Pose
from phyagentos.protocol.world.truth import Truth
from tests.contracts import make_contract

NOBODY = {"url": "http://127.0.0.1:9/v1", "model": "nobody", "timeout_s": 0.5}  # the port of `discard`
SETTINGS = JudgeSettings(
    verification=Verification.model_validate({"criteria": ["metric(peak_force_n) <= 20"], "vision": NOBODY}),
    clock=SystemClock(),
)
SESSION = make_contract(
    accept=("inside(cube, tray)", "metric(ticks) <= 1000"), hold=("upright(cube)", "metric(peak_force_n) <= 20")
)


def make_world():
    things = {
        "cube": Entity(name="cube", kind="cube", pose=Pose((0.6, 0.3, 0.03))),
        "tray": Entity(
            name="tray",
            kind="tray",
            pose=Pose((0.6, 0.3, 0.0)),
            movable=False,
            interior=Interior((0, 0, 0.035), (0.09, 0.07, 0.025)),
        ),
    }
    return Environment(time_s=1.0, scene="table", episode="g", revision=1, sensing="perceived", entities=things)


def make_bundle(folder: Path, after: Environment | None = None) -> Bundle:
    execution = Execution(ended=Ended.COMPLETED, evidence="e", ticks=9)
    facts = {"folder": folder, "session": SESSION, "execution": execution, "before": after, "after": after}
    return Bundle(**facts, holds=(), trace=(), events=())


def damage(folder: Path) -> None:
    for name in (TRAJECTORY, LOOKAHEAD, HOLDS, LOOKS):
        (folder / name).write_bytes(b"no such thing")


@pytest.fixture(params=JUDGES.names())
def definition(request):
    return JUDGES.load(request.param)


@pytest.fixture
def judge(definition):
    return definition.open(SETTINGS)


def test_a_judge_is_named_with_a_version_and_described(definition, judge):
    assert judge.name.split("/")[0] == definition.name
    assert judge.name.split("/")[1][0].isdigit()
    assert definition.description.endswith(".")


def test_nothing_that_was_not_observed_is_true(judge, tmp_path):
    answers = judge.judge(make_bundle(tmp_path))
    assert [each.text for each in answers if each.truth is Truth.TRUE and "ticks" not in each.text] == []


def test_a_damaged_bundle_is_no_reason_to_raise_and_proves_nothing(judge, tmp_path):
    damage(tmp_path)
    answers = judge.judge(make_bundle(tmp_path))
    assert [each.text for each in answers if each.truth is Truth.TRUE and "ticks" not in each.text] == []


def test_a_judge_answers_with_criteria_that_people_and_files_can_carry(judge, tmp_path):
    for each in judge.judge(make_bundle(tmp_path, make_world())):
        assert isinstance(each, Criterion)
        assert each.text
        assert each.kind
        assert each.because
        assert each.evidence
        assert "/" not in each.evidence


def test_the_same_evidence_gives_the_same_answer_and_stays_as_it_is(judge, tmp_path):
    damage(tmp_path)
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    bundle = make_bundle(tmp_path, make_world())
    assert judge.judge(bundle) == judge.judge(bundle)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before
