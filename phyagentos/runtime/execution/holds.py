"""Hold conditions and constraints: sampled all through a session, the worst kept, the first violation reported.

What cannot be seen for a moment is no violation: unknown samples count only where no sample within `BRIDGED_S` of the
last known one shows the condition again, or where the session ends in them.

Contact force (`metric(peak_force_n) <= 20`) is not sampled: a spike lasts a few milliseconds. Every report of the
target is read, which holds the greatest force since the one before.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from msgspec import UNSET

from phyagentos.errors import DefectError
from phyagentos.protocol.predicates.exchanges import find_groups
from phyagentos.protocol.predicates.predicate import (
    Evaluation,
    Predicate,
    View,
    is_metric_only,
    iter_entities,
    parse_predicate,
    worse,
)
from phyagentos.protocol.sessions.evidence import HOLDS
from phyagentos.protocol.sessions.looks import LookRole
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.truth import Truth
from phyagentos.runtime.perception.look import Look
from phyagentos.runtime.perception.world_model import BELIEF, WORLD, Need
from phyagentos.runtime.targets.wire import Step

SAMPLE_PERIODS = 5  # control periods between samples, unless given
BRIDGED_S = 1.5  # nothing is carried away, brought back and let go within
COARSE_S = 0.5  # so long a window may leave open what a look at everything may decide; between two such looks
PEAK_FORCE, PEAK_FORCE_ERROR = "peak_force_n", "peak_force_n_error"
SampleKey = tuple[str, LookRole]  # the condition, and whether its worst or its first unknown sample


@dataclass(frozen=True, slots=True)
class HoldSample:
    """The look of one sample, and the metrics measured by then."""

    look: Look
    metrics: dict[str, float]


class HoldMonitor:
    """Monitors the predicates that must be true throughout a session, sampled every so many control periods.

    Attributes:
        need: What the next sample has to show; everything where windows measured too coarsely to decide.
        samples: The worst and the first unknown sample of each condition.
        broken: The error that the predicate of a condition raised: from then on it is not watched.
    """

    def __init__(
        self,
        texts: Sequence[str],
        initial: Environment,
        target: str,
        every: int = SAMPLE_PERIODS,
        interchangeable: tuple[tuple[str, ...], ...] = (),
    ) -> None:
        self.every = every
        self._predicates: tuple[tuple[str, Predicate], ...] = tuple((text, parse_predicate(text)) for text in texts)
        self._felt = tuple(each for each in self._predicates if is_metric_only(each[1]))
        self._seen = tuple(each for each in self._predicates if each not in self._felt)
        self._initial = initial
        named = frozenset(name for _, predicate in self._predicates for name in iter_entities(predicate))
        names = named.union(*(group for group in find_groups(initial) if group & named))  # whichever of them it is
        is_of_targets = not names and not any("*" in text for text in texts)  # they report of themselves at every step
        self._named = self.need = Need(objects=names) if names or is_of_targets else WORLD
        self._looked_s = initial.time_s  # at everything, or so that all was decided
        self._peaks: dict[str, float] = {}
        self._start = View(
            now=initial, initial=initial, target=target, metrics=self._peaks, interchangeable=interchangeable
        )
        self._worst: dict[str, tuple[Evaluation, float]] = {}
        self._known_s: dict[str, float] = {}
        self._unseen: dict[str, tuple[Evaluation, float]] = {}  # the unknown samples that are not confirmed yet
        self.samples: dict[SampleKey, HoldSample] = {}
        self.broken: DefectError | None = None

    def is_due(self, tick: int) -> bool:
        """Whether the sample of this command tick is to be taken."""
        return bool(self._seen) and tick % self.every == 0

    def feel(self, step: Step, observe: Callable[[Need], Environment]) -> Criterion | None:
        """Read the contact force of a report; returns the first condition on it that is false.

        The present world is observed only when the force exceeds every earlier one.
        """
        force_n = step.contact_force_n
        if not self._predicates or force_n is None or force_n <= self._peaks.get(PEAK_FORCE, -1.0):
            return None
        self._peaks |= {PEAK_FORCE: force_n, PEAK_FORCE_ERROR: step.contact_force_error_n}
        return self._note(self._evaluate(self._felt, now := observe(BELIEF)), now) if self._felt else None

    def shows_violation(self, now: Environment) -> bool:
        """Whether a look at no more than it needs shows a condition that is false: a reason to look at everything."""
        found = [] if self.need.everything else self._evaluate(self._seen, now)
        return any(evaluation.truth is Truth.FALSE for _, evaluation in found)

    def sample(self, now: Environment, look: Look | None = None, *, is_last: bool = False) -> Criterion | None:
        """Evaluate what can be seen; returns the first condition that is false.

        `now` was observed with `need`, from `look` where the world is perceived. What the last sample of a session does
        not show stays unknown.
        """
        evaluations, look = self._evaluate(self._seen, now), look if self.need.is_look else None
        is_coarse = any(evaluation.is_marginal for _, evaluation in evaluations)
        self._looked_s = self._looked_s if is_coarse and self.need is self._named else now.time_s
        self.need = WORLD if is_coarse and now.time_s - self._looked_s >= COARSE_S else self._named
        return self._note(evaluations, now, look, is_last=is_last)

    def _evaluate(self, predicates: Iterable[tuple[str, Predicate]], now: Environment) -> list[tuple[str, Evaluation]]:
        view = replace(self._start, now=now)
        found = [(text, predicate.evaluate(view)) for text, predicate in predicates]
        if broken := next((each for _, each in found if each.defect), None):
            self.broken = DefectError("BROKEN_PYTHON", broken.because, broken.defect)
        return found

    def _note(
        self,
        evaluations: Iterable[tuple[str, Evaluation]],
        now: Environment,
        look: Look | None = None,
        *,
        is_last: bool = False,
    ) -> Criterion | None:
        violated: Criterion | None = None
        for text, evaluation in evaluations:
            if evaluation.truth is not Truth.UNKNOWN:
                self._known_s[text] = now.time_s
                self._unseen.pop(text, None)
            elif (text, LookRole.UNKNOWN) not in self.samples:
                self._keep(text, LookRole.UNKNOWN, look)
            since_s = self._known_s.get(text, self._initial.time_s)
            if evaluation.truth is Truth.UNKNOWN and now.time_s - since_s <= BRIDGED_S and not is_last:
                self._unseen[text] = (evaluation, now.time_s)
                continue
            before = self._worst.get(text)
            if before is None or worse(before[0], evaluation) is evaluation:
                self._worst[text] = (evaluation, now.time_s)
                self._keep(text, LookRole.WORST, look)
            if evaluation.truth is Truth.FALSE and violated is None:
                violated = _to_criterion(text, evaluation, now.time_s)
        return violated

    def _keep(self, text: str, role: LookRole, look: Look | None) -> None:
        if look is not None:
            self.samples[text, role] = HoldSample(look, dict(self._peaks))

    def read_worst(self) -> tuple[Criterion, ...]:
        """The worst sample of each, in the order of the contract.

        A session that ended before its first sample was due is judged on its initial snapshot.
        """
        if not self._worst and not self._unseen:
            self._note(self._evaluate(self._seen, self._initial), self._initial, is_last=True)
        for text, (evaluation, time_s) in self._unseen.items():
            before = self._worst.setdefault(text, (evaluation, time_s))
            if worse(before[0], evaluation) is evaluation:
                self._worst[text] = (evaluation, time_s)
        self._unseen.clear()
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
        alternatives=evaluation.alternatives or UNSET,
        failure="BROKEN_PYTHON" if evaluation.defect else UNSET,
    )
