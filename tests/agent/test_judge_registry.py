"""Judges as plug-ins: found through the entry points of installed packages, named in settings, failing closed."""

import sys

import pytest

from phyagentos.agent.judging.judges.judge_registry import JudgeDefinition, choose_judges
from phyagentos.assembly.verification import JUDGES, build_verifier
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.plugins import Plugins
from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.sessions.verdicts import Verdict
from phyagentos.protocol.settings.runtime_contract import read_runtime_contract
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.truth import Truth
from tests.packages import install

from .test_verifier import BUDGET, DONE, make_bundle

SHIPPED = ["holds", "lookahead", "metrics", "predicates", "vision"]
CONTRACT = """
version: 1
world_mode: lockstep
control_period_s: 0.02
physics_step_s: 0.002
command_representation: joint_position_velocity
sampling_hz: 10
"""
HASTE = """
from phyagentos.agent.judging.judges.judge_registry import JudgeDefinition
from phyagentos.protocol.world.truth import Truth
from phyagentos.protocol.sessions.verdicts import Criterion


class Haste:
    def __init__(self, ticks_max):
        self.ticks_max = ticks_max
        self.name = f"haste/1({ticks_max:g})"

    def judge(self, bundle):
        if self.ticks_max < 0:
            raise ZeroDivisionError("no time at all")
        if self.ticks_max == 0:
            return ["slow"]
        ticks = bundle.execution.ticks
        truth = Truth.TRUE if ticks <= self.ticks_max else Truth.FALSE
        because = f"{ticks} control periods"
        return [Criterion(text="in time", kind="haste", truth=truth, evidence="execution.json", because=because)]


HASTE = JudgeDefinition(
    name="haste", open=lambda settings: Haste(settings.options.get("ticks_max", 50.0)), description="Whether in time."
)
"""


@pytest.fixture
def announce(tmp_path_factory, monkeypatch):
    """Lay an installed package where Python looks for them."""

    def announce(code=HASTE, **points):
        site = tmp_path_factory.mktemp("site")
        install(site, "haste_judge", code, {"phyagentos.judges": points or {"haste": "haste_judge:HASTE"}})
        monkeypatch.syspath_prepend(site)
        monkeypatch.delitem(sys.modules, "haste_judge", raising=False)

    return announce


@pytest.fixture
def make_verifier(tmp_path):
    def make(settings: str):
        (tmp_path / "runtime_contract.yaml").write_text(CONTRACT + settings)
        return build_verifier(Workspace(tmp_path), SystemClock())

    return make


def test_a_judge_of_an_installed_package_is_found_and_weighed_like_the_own_ones(announce, make_verifier):
    announce()
    assert JUDGES.names() == sorted([*SHIPPED, "haste"])
    verifier = make_verifier("verification: {judges: [predicates, haste], options: {haste: {ticks_max: 80}}}")
    attempt = verifier.judge(make_bundle(DONE), BUDGET)
    assert (attempt.verdict, attempt.judges) == (Verdict.REPLAN, ("predicates/2", "haste/1(80)"))
    assert [(each.text, each.truth) for each in attempt.criteria][1:] == [("in time", Truth.FALSE)]


@pytest.mark.parametrize(
    ("ticks_max", "because"),
    [
        (-1, "the judge raised ZeroDivisionError: no time at all ("),
        (0, "the judge raised TypeError: it answered 'slow'; expected a Criterion ("),
    ],
)
def test_a_judge_of_others_that_fails_ends_the_node_with_its_place(announce, make_verifier, ticks_max, because):
    announce()
    verifier = make_verifier(
        f"verification: {{judges: [predicates, haste], options: {{haste: {{ticks_max: {ticks_max}}}}}}}"
    )
    attempt = verifier.judge(make_bundle(DONE), BUDGET)
    assert (attempt.verdict, attempt.cause) == (Verdict.FAILURE, "BROKEN_PYTHON")
    (criterion,) = attempt.criteria[1:]
    assert (criterion.truth, criterion.because.startswith(because)) == (Truth.UNKNOWN, True)
    assert f"haste_judge.py:{14 if ticks_max else 12})" in criterion.because


@pytest.mark.parametrize(
    "body",
    [
        "raise SystemExit(0)",
        "raise GeneratorExit",
        "raise StopIteration",
        "return None",
        "return [Criterion(text='in time', kind='haste', truth='yes')]",
        "return [Criterion(text='in time', kind='haste', truth=Truth.TRUE, measured={'s': float('nan')})]",
        "return [Criterion(text='in time', kind='haste', truth=Truth.TRUE, measured={'s': object()})]",
        "return self.judge(bundle)",
    ],
)
def test_no_answer_of_a_judge_of_others_passes_for_a_finding(announce, make_verifier, body):
    announce(HASTE.replace("if self.ticks_max < 0:", f"{body}\n        if True:"))
    attempt = make_verifier("verification: {judges: [predicates, haste]}").judge(make_bundle(DONE), BUDGET)
    assert (attempt.verdict, attempt.cause) == (Verdict.FAILURE, "BROKEN_PYTHON")
    assert "haste_judge.py:1" in attempt.criteria[-1].because


def test_a_judge_of_others_changes_nothing_that_others_judge(announce, make_verifier):
    taking = "bundle.after.entities.clear()\n        if self.ticks_max < 0:"
    announce(HASTE.replace("if self.ticks_max < 0:", taking))
    verifier = make_verifier("verification: {judges: [haste, predicates], options: {haste: {ticks_max: 999}}}")
    assert verifier.judge(make_bundle(DONE), BUDGET).verdict is Verdict.SUCCESS


def test_a_judge_that_does_not_open_is_refused_with_its_place(announce, make_verifier):
    announce(HASTE.replace("self.ticks_max = ticks_max", "self.ticks_max = ticks_max / 0"))
    with pytest.raises(DefinitionError, match=r"haste_judge\.py:\d+: BROKEN_PYTHON: found judge haste raised ZeroDiv"):
        make_verifier("verification: {judges: [predicates, haste]}")


def test_a_judge_that_is_not_installed_is_refused_in_the_settings_with_its_place(make_verifier):
    with pytest.raises(
        DefinitionError, match=r"\(judge\): found 'metric'; expected holds, .* Did you mean 'metrics'\?"
    ):
        make_verifier("verification: {judges: [predicates, metric]}")


def test_options_of_a_judge_that_is_not_asked_are_refused(make_verifier):
    with pytest.raises(DefinitionError, match="options of haste, which is not among the judges"):
        make_verifier("verification: {options: {haste: {ticks_max: 3}}}")


def test_a_package_that_does_not_load_is_refused_only_to_those_who_ask_for_it(announce, make_verifier):
    announce(code="import nothing_of_this_name")
    make_verifier("verification: {judges: [predicates, holds]}")
    with pytest.raises(
        DefinitionError, match=r"BROKEN_PYTHON: found 'haste' .* of package haste_judge raised ModuleNotFoundError"
    ):
        make_verifier("verification: {judges: [predicates, haste]}")


def test_a_judge_is_asked_once_however_often_it_is_named():
    judges = Plugins("-", {"one": JudgeDefinition(name="one", open=lambda _: None)})
    assert [each.name for each in choose_judges(judges, ["one", "one"], "--with")] == ["one"]


def test_the_shipped_settings_name_only_judges_that_there_are():
    shipped = read_runtime_contract(find_shipped_root() / "protocol" / "runtime_contract.yaml").verification
    assert set(shipped.judges) <= set(SHIPPED)
