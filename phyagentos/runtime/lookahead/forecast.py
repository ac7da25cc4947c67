"""The forecast of one session: rehearsed as it is and, where that looks bad, with a few other strategies.

Every strategy is judged in the same imagined worlds, so that two of them differ by their effect and not by chance.
"""

from collections import Counter
from dataclasses import dataclass

import msgspec

from phyagentos.protocol.capabilities.placed_scenes import read_placed
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.lookahead import Alternative, LookaheadRequest, LookaheadResult
from phyagentos.protocol.sessions.session import Ended, Session
from phyagentos.protocol.sessions.trace import Role, find_label
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.scenes import SceneSpec
from phyagentos.runtime.lookahead.rehearsal import Rehearsal, Rehearser, Stage
from phyagentos.runtime.lookahead.rollouts import Playback, find_cause
from phyagentos.runtime.lookahead.sprt import is_decided
from phyagentos.runtime.lookahead.strategies import Tried, propose
from phyagentos.runtime.lookahead.uncertainty import ImaginedStart, draw_starts

ALTERNATIVES_MAX = 5  # each costs as much as the contract's own way
BATCH = 2  # rollouts between two looks at their count, whatever the number of threads


@dataclass(slots=True, kw_only=True)
class Forecaster:
    """Forecasts sessions of one target.

    Attributes:
        threads: Of the rollouts.
    """

    rehearser: Rehearser
    threads: int = 1

    def forecast(
        self, session: Session, request: LookaheadRequest, tree: str, environment: Environment
    ) -> LookaheadResult:
        """How a session is likely to end from the estimate on, carried out by the tree of its skill."""
        clock = self.rehearser.clock
        began_s = clock.now_s()
        spec = read_placed(self.rehearser.library, environment.scene)
        stage = self.rehearser.open_stage(environment)
        worlds = _Worlds(stage, spec, environment, self.rehearser.profile, request)
        first, rehearsal = self._try_out(session, worlds, tree)
        results, tried = [first], [_describe(first, rehearsal)]
        while results[-1].share < request.threshold and len(tried) <= ALTERNATIVES_MAX:
            if (strategy := propose(tried)) is None:
                break
            other = msgspec.structs.replace(session, strategy=strategy)
            result, attempt = self._try_out(other, worlds, tree, is_other=True)
            results.append(result)
            tried.append(_describe(result, attempt))
        return LookaheadResult(
            samples=first.samples,
            succeeded=first.succeeded,
            threshold=request.threshold,
            causes=first.causes,
            cost_ms=1e3 * (clock.now_s() - began_s),
            notes=_explain(environment, spec, rehearsal),
            alternatives=tuple(sorted(results[1:], key=lambda each: -each.share)),
        )

    def _try_out(
        self, session: Session, worlds: "_Worlds", tree: str, *, is_other: bool = False
    ) -> tuple[Alternative, Rehearsal]:
        """One strategy, in as many worlds as the decision takes.

        A strategy that fails even in the world as believed needs no rollouts; nor does an alternative that fails there.
        """
        rehearsal = self.rehearser.rehearse(worlds.stage, session, tree)
        if rehearsal.outcome.ended is not Ended.COMPLETED:
            return _count(session, [rehearsal.outcome.code or str(rehearsal.outcome.ended).upper()]), rehearsal
        request, playback = worlds.request, Playback(rehearsal, self.threads)
        nominal = playback.nominal
        if is_other and (cause := find_cause(nominal, nominal, rehearsal)):
            return _count(session, [cause]), rehearsal
        causes: list[str] = []
        while not causes or not is_decided(causes.count(""), len(causes), request.threshold, request.samples):
            rollouts = playback.play(worlds.get(len(causes), len(causes) + BATCH))
            causes += [find_cause(rollout, nominal, rehearsal) for rollout in rollouts]
        return _count(session, causes), rehearsal


class _Worlds:
    """Worlds that agree with an estimate, drawn on demand and shared by all strategies."""

    def __init__(
        self, stage: Stage, spec: SceneSpec, environment: Environment, profile: TargetProfile, request: LookaheadRequest
    ) -> None:
        self.stage, self.request = stage, request
        self._spec, self._environment, self._profile = spec, environment, profile
        self._drawn: list[ImaginedStart] = []

    def get(self, first: int, end: int) -> list[ImaginedStart]:
        """Those from number `first` up to `end`, as far as the request allows."""
        end, drawn = min(end, self.request.samples), len(self._drawn)
        if end > drawn:
            self._drawn += draw_starts(
                self.stage.physics,
                self.stage.start,
                self._spec,
                self._environment,
                self._profile,
                samples=end - drawn,
                seed=self.request.seed,
                first=drawn,
            )
        return self._drawn[first:end]


def _count(session: Session, causes: list[str]) -> Alternative:
    """Rollouts of one strategy, counted; an empty cause is a success."""
    failures = Counter(cause for cause in causes if cause)
    return Alternative(
        strategy=session.strategy,
        samples=len(causes),
        succeeded=len(causes) - failures.total(),
        causes=dict(sorted(failures.items())),
    )


def _describe(result: Alternative, rehearsal: Rehearsal) -> Tried:
    return Tried(
        strategy=result.strategy,
        share=result.share,
        cause=result.likely_cause,
        grasp=find_label(rehearsal.trace, Role.PLAN_GRASP),
        site=find_label(rehearsal.trace, Role.PLAN_SITE),
    )


def _explain(environment: Environment, spec: SceneSpec, rehearsal: Rehearsal) -> tuple[str, ...]:
    unseen = sorted(spec.bodies.keys() - environment.entities.keys())
    spans = sorted(name for name, body in spec.bodies.items() if body.mass_span_kg or body.grip_span)
    notes = [f"from the estimate at {environment.time_s:.2f} s, sensing {environment.sensing}"]
    notes += [f"left out, since the estimate does not hold them: {', '.join(unseen)}"] if unseen else []
    notes += [f"weight or grip drawn from declared spans: {', '.join(spans)}"] if spans else []
    outcome = rehearsal.outcome
    if outcome.ended is not Ended.COMPLETED:
        notes.append(f"the rehearsal itself ended {outcome.ended} at {outcome.leaf or 'its start'}: {outcome.message}")
    return tuple(notes)
