"""Hold conditions and constraints: sampled all through a session, the worst kept, the first violation reported."""

from collections.abc import Sequence

from phyagentos.protocol.environment import Environment
from phyagentos.protocol.evidence import HOLDS
from phyagentos.protocol.predicates.predicate import Evaluation, Predicate, View, iter_entities, parse_predicate, worse
from phyagentos.protocol.verdicts import Criterion, Truth

SAMPLE_PERIODS = 5  # control periods between samples: 10 Hz of simulated time


class HoldMonitor:
    """Watches the predicates that must be true all through.

    Args:
        texts: As in the contract, fully substituted.
        initial: The snapshot that `moved` compares with.
        target: Whose session it is.

    Attributes:
        names: Of the things and places that the conditions are about.
    """

    def __init__(self, texts: Sequence[str], initial: Environment, target: str) -> None:
        self._predicates: tuple[tuple[str, Predicate], ...] = tuple((text, parse_predicate(text)) for text in texts)
        self._initial = initial
        self._target = target
        self.names = frozenset(name for _, predicate in self._predicates for name in iter_entities(predicate))
        self._worst: dict[str, tuple[Evaluation, float]] = {}

    def is_due(self, tick: int) -> bool:
        """Whether the sample of this command tick is to be taken."""
        return bool(self._predicates) and tick % SAMPLE_PERIODS == 0

    def sample(self, now: Environment) -> Criterion | None:
        """Evaluate all; returns the first that is false."""
        violated: Criterion | None = None
        view = View(now=now, initial=self._initial, target=self._target)
        for text, predicate in self._predicates:
            evaluation = predicate.evaluate(view)
            before = self._worst.get(text)
            if before is None or worse(before[0], evaluation) is evaluation:
                self._worst[text] = (evaluation, now.time_s)
            if evaluation.truth is Truth.FALSE and violated is None:
                violated = _to_criterion(text, evaluation, now.time_s)
        return violated

    def read_worst(self) -> tuple[Criterion, ...]:
        """The worst sample of each, in the order of the contract."""
        return tuple(_to_criterion(text, *self._worst[text]) for text, _ in self._predicates if text in self._worst)


def _to_criterion(text: str, evaluation: Evaluation, time_s: float) -> Criterion:
    return Criterion(
        text=text,
        kind="hold",
        truth=evaluation.truth,
        measured=evaluation.measured,
        evidence=HOLDS,
        at_s=time_s,
        because=evaluation.because,
    )
