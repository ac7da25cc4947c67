"""The methodological level: corrections of failures, from hypothesis to verified lesson. Paper section 4.3.

A lesson follows from episodes alone. It is born as a hypothesis when a session with another strategy follows a failure
of the same node, and only the verdict on such a session verifies it.
"""

from collections.abc import Callable

import msgspec

from phyagentos.agent.memory.entries import Count, Entry, name_objects
from phyagentos.agent.memory.episodes import Episode
from phyagentos.agent.memory.scopes import compute_id, compute_scope, name_left_out, widen
from phyagentos.agent.memory.semantic import Trial
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.lessons import Lesson
from phyagentos.protocol.sessions.means import DEFAULT_MEANS, Means, Preparation
from phyagentos.protocol.sessions.memory_entries import EntryState, Risk, Scope
from phyagentos.protocol.sessions.strategy import DEFAULT_STRATEGY, Strategy

CHAINS_KEPT = 5  # of failure and verified correction, the latest
ACCIDENTS_KEPT = 5
CASES_KEPT = 16  # different cases that a widened lesson was verified in
CASES_NEEDED = 2  # before a widened lesson counts
EXPIRES_AFTER = 20_000  # records of memory without a confirmation, after the first; each further one doubles it
DOUBTED_BELOW, DOUBTED_FROM = 0.4, 3  # share of outcomes that speak for it, once there are so many


class Failure(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A session that was not a success, and how it began: what a child may correct.

    All but `session` and `strategy` is of the first session of the node, `root`; `prepared` is what was done since.
    """

    session: str
    goal: str
    node: str
    root: str
    cause: str
    objective: str = ""
    begun: str = ""
    strategy: Strategy = DEFAULT_STRATEGY
    scope: Scope
    parameters: Fields = {}
    prepared: tuple[Preparation, ...] = ()


class Chain(msgspec.Struct, frozen=True, kw_only=True):
    """A failure and the session that corrected it, whose verdict verifies the lesson."""

    failed: str
    corrected: str


class Correction(Entry, frozen=True, kw_only=True, omit_defaults=True):
    """A lesson while it is learned; children that followed a failure with it are counted, and a success verifies it.

    Attributes:
        values: Parts of the strategy that were the same every time.
        means: What was done by other means; parameters as in the latest success.
        labels: Lists of the strategy: key -> label -> in how many verified corrections it stood.
        cases: What is left open by the scope, as far as it was verified.
        applied: First attempts that it advised.
    """

    objective: str
    cause: str
    values: Fields = {}
    labels: dict[str, dict[str, int]] = {}
    means: Means = DEFAULT_MEANS
    goals: tuple[str, ...] = ()
    accidents: tuple[str, ...] = ()
    trial: Trial = Trial()
    applied: Count = Count()
    cases: tuple[str, ...] = ()
    chains: tuple[Chain, ...] = ()

    @property
    def outcomes(self) -> Count:
        """Every verdict that speaks for or against it."""
        return Count(
            successes=self.count.successes + self.applied.successes, trials=self.count.trials + self.applied.trials
        )

    @property
    def advice(self) -> Strategy:
        """What to do differently; of a list only what stood in half of the verified corrections."""
        return self._collect(lambda count: 2 * count >= self.count.successes)

    @property
    def tried_way(self) -> Strategy:
        """All that was ever done differently."""
        return self._collect(lambda count: True)

    def _collect(self, is_common: Callable[[int], bool]) -> Strategy:
        lists = {
            key: sorted(label for label, count in counted.items() if is_common(count))
            for key, counted in self.labels.items()
        }
        return msgspec.convert({**self.values, **lists}, Strategy)

    def _weigh(self, seq: int) -> tuple[EntryState, str]:
        if not self.count.successes:
            return EntryState.HYPOTHESIS, ""
        if self.accidents:
            return EntryState.EXPIRED, f"a safety event met {self.accidents[-1]}, which followed it"
        outcomes = self.outcomes
        if outcomes.trials >= DOUBTED_FROM and outcomes.mean < DOUBTED_BELOW:
            return EntryState.EXPIRED, f"contradicted: {outcomes} outcomes speak for it"
        if seq - self.last_seq > (life := EXPIRES_AFTER << min(outcomes.successes - 1, 32)):
            return EntryState.EXPIRED, f"nothing confirmed it in the last {life} episodes"
        if self.amended is None and any(self.cases) and len(self.cases) < CASES_NEEDED:
            return EntryState.HYPOTHESIS, "verified in one case only, not yet beyond it"
        return EntryState.ACTIVE, ""

    def apply(self, episode: Episode, seq: int) -> "Correction":
        """The lesson after a first attempt that it advised."""
        return msgspec.structs.replace(
            self,
            applied=self.applied.add(success=episode.is_success),
            trial=self.trial.add(episode.seed, success=episode.is_success),
            accidents=(*self.accidents, *([episode.session] if episode.safety else []))[-ACCIDENTS_KEPT:],
            last_seq=seq if episode.is_success else self.last_seq,
        )

    def describe(self, seq: int, baseline: Count) -> Lesson:
        """Its entry of LESSONS.md at record `seq` of memory; `baseline` counts first attempts without it."""
        where, advice = self.where, self.advice
        what = f"a child {join_ways(advice or self.tried_way, self.means)}"
        verb = "helps" if self.is_active(seq) else "was tried"
        return Lesson(
            statement=f"When {where.skill} of {name_objects(where)} ends with {self.cause}, {what} {verb}.",
            **self.describe_common(seq),
            objective=self.objective,
            cause=self.cause,
            advice=advice,
            means=self.means,
            risk=where.risk or Risk.NORMAL,
            verified_by=self.chains[-1].corrected if self.chains else "",
            baseline=str(baseline),
        )


def begin_failure(episode: Episode) -> Failure:
    """The first failure of a node."""
    return Failure(
        session=episode.session,
        goal=episode.goal,
        node=episode.node,
        root=episode.session,
        cause=episode.cause,
        objective=episode.objective,
        begun=episode.begun,
        strategy=episode.strategy,
        scope=compute_scope(episode),
        parameters=episode.parameters,
    )


def propose(failure: Failure, child: Episode) -> tuple[Correction, ...]:
    """The lessons that a child of a failure tests, without any count: its own case, and that widened.

    Empty when the child is of another node, or did nothing that its parent had not done. What has to come first, and
    other values of parameters, are believed in their own case alone.
    """
    if (child.goal, child.node) != (failure.goal, failure.node) or child.parent != failure.session:
        return ()
    means = find_means(failure, child)
    if means.skill and child.resumes:  # nothing is held at the beginning
        return ()
    if not means and (not child.strategy or child.strategy == failure.strategy):
        return ()
    is_wide = means == Means(skill=means.skill)
    scopes = (failure.scope, widen(failure.scope, child.strategy)) if is_wide else (failure.scope,)
    return tuple(_begin(each, means, failure, child) for each in dict.fromkeys(scopes))


def find_means(failure: Failure, child: Episode) -> Means:
    """What a child did by other means than the first session of its node."""
    first = failure.scope
    skill, target = (child.skill if child.skill != first.skill else "", child.target)
    changed = {key: value for key, value in child.parameters.items() if failure.parameters.get(key) != value}
    return Means(
        skill=skill,
        target=target if target != first.target else "",
        parameters={} if skill else changed,  # of another skill they follow from what is wanted
        prepare=failure.prepared,
    )


def test(correction: Correction, failure: Failure, child: Episode, seq: int) -> Correction:
    """The lesson after the verdict on a child that followed it."""
    count = correction.count.add(success=child.is_success)
    if not child.is_success:
        return msgspec.structs.replace(correction, count=count, last_seq=correction.last_seq or seq)
    labels = {key: dict(counted) for key, counted in correction.labels.items()}
    for key, items in _split(child.strategy)[1].items():
        counted = labels.setdefault(key, {})
        for label in items:
            counted[label] = counted.get(label, 0) + 1
    case = name_left_out(failure.scope, correction.scope)
    return msgspec.structs.replace(
        correction,
        count=count,
        labels=labels,
        cases=tuple(dict.fromkeys((*correction.cases, case)))[-CASES_KEPT:],
        chains=(*correction.chains, Chain(failed=failure.root, corrected=child.session))[-CHAINS_KEPT:],
        evidence=correction.join_evidence(child),
        last_seq=seq,
        goals=tuple(dict.fromkeys((*correction.goals, *filter(None, (child.graph,)))))[-CASES_KEPT:],
        means=msgspec.structs.replace(correction.means, parameters=find_means(failure, child).parameters),
    )


def join_ways(strategy: Strategy, means: Means) -> str:
    """Both as words."""
    return ", ".join(filter(None, (str(means), str(strategy))))


def _begin(scope: Scope, means: Means, failure: Failure, child: Episode) -> Correction:
    values, lists = _split(child.strategy)
    shape: dict[str, object] = {
        **values,
        **dict.fromkeys(lists, "*"),
    }  # what stands in the lists is counted, not part of its name
    if means:
        named: dict[str, object] = msgspec.to_builtins(means)
        shape["means"] = named | {"parameters": sorted(means.parameters)}
    return Correction(
        id=compute_id("lesson", scope, failure.cause, shape),
        scope=scope,
        objective=failure.objective,
        cause=failure.cause,
        values=values,
        labels={key: {} for key in lists},
        means=means,
    )


def _split(strategy: Strategy) -> tuple[Fields, dict[str, list[str]]]:
    """Single values, and lists of labels, each by its key."""
    keyed: dict[str, object] = msgspec.to_builtins(strategy)
    lists = {key: list(value) for key, value in keyed.items() if isinstance(value, list | tuple)}
    return {key: value for key, value in keyed.items() if key not in lists}, lists
