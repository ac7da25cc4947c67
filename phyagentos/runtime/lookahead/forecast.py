"""The forecast of one session: rehearsed as it is and, where that looks bad, in a few other ways.

Upstream: the worker, through `process`. Downstream: preflight's verdict, the evidence, the agent's revision. Every way
is judged in the same imagined worlds, so that two ways differ by what they do and not by their luck.
"""

from collections import Counter
from dataclasses import dataclass

import msgspec

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.lookahead import Alternative, LookaheadRequest, LookaheadResult
from phyagentos.protocol.sessions.session import Ended, Session
from phyagentos.protocol.sessions.trace import Role, find_label
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.scenes import SceneSpec, read_scene
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
        rehearser: Carries them out in the imagination.
        threads: Of the rollouts.
    """

    rehearser: Rehearser
    threads: int = 1

    def forecast(
        self, session: Session, request: LookaheadRequest, tree: str, environment: Environment
    ) -> LookaheadResult:
        """How a session is likely to end, from the estimate on.

        Args:
            session: The contract.
            request: How often at most, how sure, from which seed.
            tree: Of its skill.
            environment: The estimate.
        """
        clock = self.rehearser.clock
        began_s = clock.now_s()
        spec = read_scene(self.rehearser.library.get_scene(environment.scene))
        stage = self.rehearser.open_stage(environment)
        worlds = _Worlds(stage, spec, environment, self.rehearser.profile, request)
        first, rehearsal = self._try_out(session, worlds, tree)
        results, tried = [first], [_tell(first, rehearsal)]
        while results[-1].share < request.threshold and len(tried) <= ALTERNATIVES_MAX:
            strategy = propose(tried)
            if strategy is None:
                break
            other = msgspec.structs.replace(session, strategy=strategy)
            result, attempt = self._try_out(other, worlds, tree, is_other=True)
            results.append(result)
            tried.append(_tell(result, attempt))
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
        """One strategy, in so many worlds as it takes to be sure.

        What cannot be carried out even in the world as believed needs no rollouts, and another way than the contract's
        that fails there is not worth any.
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
            courses = playback.play(worlds.get(len(causes), len(causes) + BATCH))
            causes += [find_cause(course, nominal, rehearsal) for course in courses]
        return _count(session, causes), rehearsal


class _Worlds:
    """The worlds that an estimate could be, drawn when they are wanted; every way meets the same ones.

    Args:
        stage: Of the estimate.
        spec: The inventory, with its spans.
        environment: The estimate.
        profile: The robot.
        request: How many there are, and from which seed.
    """

    def __init__(
        self,
        stage: Stage,
        spec: SceneSpec,
        environment: Environment,
        profile: TargetProfile,
        request: LookaheadRequest,
    ) -> None:
        self.stage, self.request = stage, request
        self._spec, self._environment, self._profile = spec, environment, profile
        self._drawn: list[ImaginedStart] = []

    def get(self, first: int, end: int) -> list[ImaginedStart]:
        """Those from number `first` up to `end`, as far as there are so many."""
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
    """What the rollouts of one strategy came to; an empty cause is a success."""
    failures = Counter(cause for cause in causes if cause)
    return Alternative(
        strategy=session.strategy,
        samples=len(causes),
        succeeded=len(causes) - failures.total(),
        causes=dict(sorted(failures.items())),
    )


def _tell(result: Alternative, rehearsal: Rehearsal) -> Tried:
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
