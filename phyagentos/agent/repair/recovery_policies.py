"""The port of repair policies, and the policy that ships: repair by effect."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Protocol

from phyagentos.agent.repair.alternative import Alternative, AlternativeKind, Decision, choose_by_worth
from phyagentos.agent.repair.case import Case
from phyagentos.agent.repair.clearing import propose_clearing
from phyagentos.agent.repair.looking import propose_looking
from phyagentos.agent.repair.other_means import propose_other_skill, propose_other_target
from phyagentos.agent.repair.repetition import find_repeated, find_unseen
from phyagentos.agent.repair.retrying import propose_retry

Generator = Callable[[Case], Iterator[Alternative]]

GENERATORS: tuple[Generator, ...] = (
    propose_looking,
    propose_retry,
    propose_other_skill,
    propose_clearing,
    propose_other_target,
)


class RepairPolicy(Protocol):
    """Decides how a node continues.

    Attributes:
        restores: Whether finished nodes whose achievement is lost are opened again.
    """

    name: str
    restores: bool

    def choose(self, case: Case) -> Decision:
        """The repair of a missed objective."""


class GraphRepair:
    """Chooses among alternatives by their effect, and repeats only lost work."""

    name = "repair"
    restores = True

    def __init__(self, generators: tuple[Generator, ...] = GENERATORS) -> None:
        self._generators = generators

    def choose(self, case: Case) -> Decision:
        """The alternative of least expected cost; looks come first."""
        alternatives = [_weigh(case, each) for generator in self._generators for each in generator(case)]
        looks = [each for each in alternatives if each.kind is AlternativeKind.LOOK]
        if looks and choose_by_worth(case, looks).chosen.kind is AlternativeKind.LOOK:
            return choose_by_worth(case, looks)
        return choose_by_worth(case, alternatives)


def _weigh(case: Case, alternative: Alternative) -> Alternative:
    """The alternative, without a chance where it would only repeat what failed, or be refused."""
    revision = alternative.revision
    if revision is None or alternative.chance <= 0.0:
        return alternative
    vain = find_repeated(case, revision) or find_unseen(case, revision)
    return replace(alternative, chance=0.0, because=vain) if vain else alternative
