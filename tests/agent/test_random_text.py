"""No decision reads a sentence: with every text for people replaced, causes, verdicts and repairs stay the same.

The replacement is random and full of what code might search for: codes, predicates, names. Bundles and journal records
are scrambled where the agent reads them, criteria and judgements where they are formed.
"""

import dataclasses
from enum import Enum
from typing import Any

import msgspec
import numpy as np
import pytest

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.judging.causes import Cause, CauseClass
from phyagentos.agent.judging.diagnosis import diagnose, diagnose_after_looking
from phyagentos.agent.judging.judges.predicates import evaluate_criterion
from phyagentos.agent.repair.clearing import propose_clearing
from phyagentos.agent.repair.looking import propose_looking
from phyagentos.agent.repair.other_means import propose_other_skill, propose_other_target
from phyagentos.agent.repair.recovery_policies import GENERATORS
from phyagentos.agent.repair.retrying import propose_retry
from phyagentos.codes import CODES
from phyagentos.errors import Problem
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.world.truth import Truth

from .conftest import make_world
from .test_diagnosis import COURSES, JUDGING, criterion, make_bundle, moved
from .test_repair import HEMMED_IN, HOLDING, NEAR, ROOT, make_box, make_case, met
from .test_repair import make_table_world as make_repair_world

TEXTS = {"message", "because", "reason", "detail"}
OF_PROBLEMS = {"found", "expected", "hint", "triggered_by"}
POOL = [*CODES, "visible(red_cube)", "holding(", "inside(red_cube, red_tray)", "MODEL_", "red_cube", "true", "moved"]


class Babble:
    """Replaces what is meant for people in structs, dataclasses and plain data; every call says something else."""

    def __init__(self) -> None:
        self._rng = np.random.default_rng(1)

    def say(self) -> str:
        """All that code might search for, in an order of its own."""
        return f"{' '.join(self._rng.permutation(POOL))}: {self._rng.random()}"

    def scramble(self, value: Any) -> Any:
        if isinstance(value, msgspec.Struct):
            fields = value.__struct_fields__
            texts = TEXTS | (OF_PROBLEMS if isinstance(value, Problem) else set())
            return msgspec.structs.replace(value, **{n: self._change(n, getattr(value, n), texts) for n in fields})
        if dataclasses.is_dataclass(value) and not isinstance(value, type | Catalogue):
            names = [each.name for each in dataclasses.fields(value) if each.init]
            return dataclasses.replace(value, **{n: self._change(n, getattr(value, n), TEXTS) for n in names})
        if isinstance(value, dict):
            texts = TEXTS | (OF_PROBLEMS if {"code", "address"} <= value.keys() else set())
            return {key: self._change(key, each, texts) for key, each in value.items()}
        return type(value)(map(self.scramble, value)) if type(value) in {list, tuple} else value

    def _change(self, name: str, value: Any, texts: set[str]) -> Any:
        if name in texts and isinstance(value, str) and not isinstance(value, Enum):
            return self.say()
        return self.scramble(value)


@pytest.fixture
def babble():
    return Babble()


def judge_all(bundle):
    return [evaluate_criterion(text, "accept", bundle) for text in bundle.session.accept]


def violated(bundle):
    return [criterion("upright(bottle)", Truth.FALSE, "constraint")]


MORE = [
    (make_bundle(make_world(), code="NO_IK"), judge_all, CauseClass.PLANNING),
    (make_bundle(make_world(), ended="timed_out", code="TIMED_OUT"), judge_all, CauseClass.TIMEOUT),
    (make_bundle(make_world(), ended="safety_stop", code="CONSTRAINT_VIOLATED"), violated, CauseClass.SAFETY),
    (make_bundle(make_world(), code="A_CODE_OF_NOBODY"), judge_all, CauseClass.OTHER),
]
RECORDED = [
    *((make_bundle(after, stage, **execution), judge_all, kind) for after, stage, execution, _, kind in COURSES),
    *(
        (make_bundle(moved(), ended="completed"), lambda _, found=found: found, CauseClass.VERIFIER)
        for found, _ in JUDGING
    ),
    *MORE,
]


def test_each_class_of_causes_is_among_the_recorded_cases():
    assert {kind for _, _, kind in RECORDED} == set(CauseClass)


@pytest.mark.parametrize(("bundle", "judge", "kind"), RECORDED)
def test_a_cause_is_the_same_whatever_the_messages_say(bundle, judge, kind, babble):
    found = judge(bundle)
    plain = diagnose(bundle, found)
    assert plain.kind is kind
    for ask in (diagnose, diagnose_after_looking):
        told, scrambled = ask(bundle, found), ask(babble.scramble(bundle), babble.scramble(found))
        names = ("cause", "object", "is_hopeless", "stage", "kind")
        assert [getattr(scrambled, name) for name in names] == [getattr(told, name) for name in names]


@pytest.fixture(scope="module")
def shipped() -> Catalogue:
    catalogue = Catalogue.read(Library((ROOT,)))
    twin = catalogue.targets["panda"].model_copy(update={"target": "twin"})
    return Catalogue(skills=catalogue.skills, targets={**catalogue.targets, "twin": twin}, scenes={})


def stand_beside(world):
    return msgspec.structs.replace(world, targets={**world.targets, "twin": world.targets["panda"]})


FULL = make_repair_world(make_box("red_cube", (0.5, 0.0, 0.02)), make_box("post", (0.5, -0.3, 0.03), 0.03))
CASES = [
    (propose_looking, Cause.EVIDENCE_MISSING, {"missing": ("red_cube",)}),
    (propose_retry, Cause.GRASP_LOST, {"trace": met("post")}),
    (propose_other_skill, Cause.RUNNER_LOST, {"world": HOLDING, "contract": NEAR}),
    (propose_other_skill, Cause.IMPOSSIBLE, {}),
    (propose_clearing, Cause.NO_PLAN, HEMMED_IN),
    (propose_clearing, Cause.NO_PLAN, {"code": "NO_FREE_SITE", "world": FULL}),
    (
        propose_other_target,
        Cause.TARGET_LOST,
        {"world": stand_beside(make_repair_world(make_box("red_cube", (0.5, 0, 0.02))))},
    ),
]


def test_each_generator_of_repairs_is_among_the_cases():
    assert {generator for generator, _, _ in CASES} == set(GENERATORS)


@pytest.mark.parametrize(("generator", "cause", "facts"), CASES)
def test_a_repair_is_the_same_whatever_the_messages_say(generator, cause, facts, shipped, babble):
    case = make_case(shipped, cause, **facts)

    def tell(case):
        found = list(generator(case))
        decisive = ("parent", "strategy", "requires", "purpose", "lead", "threshold")
        return [
            (each.kind, each.chance, find_means(each.revision), *(getattr(each.revision, name) for name in decisive))
            for each in found
        ]

    plain = tell(case)
    assert plain, f"{generator.__name__} proposes nothing for its own case"
    assert tell(babble.scramble(case)) == plain


def find_means(revision):
    choice = revision.choice
    return choice and (choice.skill, choice.target, choice.parameters)
