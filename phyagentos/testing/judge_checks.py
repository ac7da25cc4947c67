"""What every judge has to satisfy: named with a version, repeatable, reading only, failing closed."""

from pathlib import Path

from phyagentos.agent.judging.judges.judge_registry import JudgeDefinition, JudgeSettings
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.evidence import HOLDS, TRAJECTORY, Bundle
from phyagentos.protocol.sessions.lookahead import LOOKAHEAD
from phyagentos.protocol.sessions.looks import LOOKS
from phyagentos.protocol.sessions.session import Ended, Execution
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.settings.verification import JudgeOption, Verification
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.truth import Truth
from phyagentos.testing.worlds import make_contract, make_cube, make_tray, make_world

ABSENT = {"url": "http://127.0.0.1:9/v1", "model": "absent", "timeout_s": 0.5}  # the port of `discard`


def check_judge(definition: JudgeDefinition, folder: Path, **options: JudgeOption) -> None:
    """Ask a judge about an empty, a damaged and a whole bundle in an empty `folder`.

    Raises AssertionError where it is not named `name/version`, calls anything true that was not observed, answers
    with anything but criteria that people can read, answers the same question differently, or changes evidence.
    """
    verification = Verification.model_validate({"criteria": ["metric(peak_force_n) <= 20"], "vision": ABSENT})
    judge = definition.open(JudgeSettings(verification=verification, clock=SystemClock(), options=options))
    name, _, version = judge.name.partition("/")
    assert name == definition.name, f"{judge.name} is not {definition.name}/VERSION"
    assert version[:1].isdigit(), f"{judge.name} names no version"
    assert definition.description.endswith("."), "the description is no sentence"
    _check_criteria(judge.judge(_make_bundle(folder)), may_be_true=False)
    for file in (TRAJECTORY, LOOKAHEAD, HOLDS, LOOKS):
        (folder / file).write_bytes(b"no such content")
    _check_criteria(judge.judge(_make_bundle(folder)), may_be_true=False)
    before, whole = _read(folder), _make_bundle(folder, make_world(make_cube(), make_tray(), sensing="perceived"))
    answers = judge.judge(whole)
    _check_criteria(answers, may_be_true=True)
    assert answers == judge.judge(whole), "the same evidence gives two answers"
    assert _read(folder) == before, "evidence was changed"


def _make_bundle(folder: Path, world: Environment | None = None) -> Bundle:
    session = make_contract(
        accept=("inside(red_cube, red_tray)", "metric(ticks) <= 1000"),
        hold=("upright(red_cube)", "metric(peak_force_n) <= 20"),
    )
    execution = Execution(ended=Ended.COMPLETED, evidence="e", ticks=9)
    return Bundle(
        folder=folder,
        session=session,
        execution=execution,
        before=world,
        after=world,
        holds=(),
        trace=(),
        events=(),
    )


def _check_criteria(answers: object, *, may_be_true: bool) -> None:
    assert isinstance(answers, list | tuple), f"the judge answered with a {type(answers).__name__}"
    for each in answers:
        assert isinstance(each, Criterion), f"the judge answered with a {type(each).__name__}"
        assert each.text, "a criterion without a text"
        assert each.kind, f"{each.text} has no kind"
        assert each.because, f"{each.text} has no reason"
        assert may_be_true or each.truth is not Truth.TRUE or "ticks" in each.text, f"{each.text}: was not observed"
        assert not may_be_true or (each.evidence and "/" not in each.evidence), f"{each.text} names no file of evidence"


def _read(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}
