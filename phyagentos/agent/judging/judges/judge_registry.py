"""The port of judges, and their registry by the names that `verification.judges` and `paos verify --with` use.

Installed packages announce a `JudgeDefinition` by the entry point group `phyagentos.judges`, under its own name. Where
its judge raises, or answers with anything but criteria, its answer is unknown.
"""

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import msgspec
from msgspec import UNSET, UnsetType

from phyagentos.agent.judging.causes import Cause
from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, Problem, blaming, find_place, is_defect, list_foreign_errors
from phyagentos.overtime import limit_time
from phyagentos.plugins import Plugins
from phyagentos.protocol.documents.plain_data import to_numbers, to_plain
from phyagentos.protocol.sessions.evidence import Bundle
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.settings.verification import JudgeOption, Verification
from phyagentos.protocol.world.truth import Truth

JUDGE_S = 300.0  # for a judge of a plug-in, which may ask a model
FORESEEN = "lookahead"
"""Kind of predictions: recorded with every judgement, decisive only where nothing was observed that could decide."""


class Judge(Protocol):
    """Answers for one kind of criterion."""

    @property
    def name(self) -> str:
        """Name, version and configuration, as recorded with every judgement (`predicates/2`)."""

    def judge(self, bundle: Bundle) -> Sequence[Criterion]:
        """Every criterion of this kind in the session's contract or the settings, each with its evidence."""


def make_unknown(text: str, kind: str, evidence: str, because: str, *, failure: str | UnsetType = UNSET) -> Criterion:
    """An undecided criterion, and why; `failure` is the code of a judge that gave no usable answer."""
    return Criterion(text=text, kind=kind, truth=Truth.UNKNOWN, evidence=evidence, because=because, failure=failure)


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgeSettings:
    """Settings of a judge; `options` are those for it alone, `address` is for messages."""

    verification: Verification
    clock: Clock
    options: Mapping[str, JudgeOption] = field(default_factory=dict)
    address: str = "runtime_contract.yaml: verification"


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgeDefinition:
    """One judge.

    Attributes:
        open: Makes it; raises DefinitionError for unusable settings.
        is_costly: Whether it is asked last, and only while nothing is false.
    """

    name: str
    open: Callable[[JudgeSettings], Judge]
    is_costly: bool = False
    description: str = ""


def choose_judges(judges: Plugins[JudgeDefinition], names: Sequence[str], address: str) -> list[JudgeDefinition]:
    """Those of these names, in this order, each once.

    Raises DefinitionError `UNKNOWN_NAME` for each name that is none; `BROKEN_PYTHON`.
    """
    known = judges.names()
    if unknown := [name for name in names if name not in known]:
        raise DefinitionError([Problem.unknown("judge", address, each, known) for each in unknown])
    return [judges.load(name, address) for name in dict.fromkeys(names)]


@dataclass(frozen=True, slots=True)
class ForeignJudge:
    """Wraps a judge of a plug-in, which has this `name`: its failures become unknown criteria of `kind`."""

    other: Judge
    kind: str
    name: str

    @classmethod
    def open(cls, definition: JudgeDefinition, settings: JudgeSettings) -> "ForeignJudge":
        """The judge of a plug-in; raises DefinitionError `BROKEN_PYTHON`."""
        with blaming(f"judge {definition.name}", definition.open):
            judge = definition.open(settings)
            return cls(judge, definition.name, str(judge.name))

    def judge(self, bundle: Bundle) -> Sequence[Criterion]:
        """Criteria of the wrapped judge, which gets a copy of the evidence; an unknown one where it failed."""
        try:
            with limit_time(JUDGE_S):
                return [_accept(each) for each in self.other.judge(copy.deepcopy(bundle))]
        except list_foreign_errors() as error:  # the session must be judged
            raised = f"the judge raised {type(error).__name__}: {error}"
            if not is_defect(error):
                return [self._fail(raised, Cause.JUDGE_FAILED)]
            place = find_place(error, type(self.other), self.other.judge)
            return [self._fail(f"{raised} ({place})", Cause.BROKEN_PYTHON)]

    def _fail(self, because: str, failure: Cause) -> Criterion:
        return make_unknown(self.kind, self.kind, "", because, failure=failure)


def _accept(answer: object) -> Criterion:
    """A criterion of plain data; raises TypeError or ValueError."""
    if not isinstance(answer, Criterion):
        raise TypeError(f"it answered {answer!r:.80}; expected a Criterion")
    return msgspec.convert(to_plain(answer) | {"measured": to_numbers(answer.measured)}, Criterion)
