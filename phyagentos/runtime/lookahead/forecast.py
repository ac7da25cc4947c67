"""The forecast of one session: rehearsed as it is and, where that looks bad, in a few other ways.

Upstream: the worker, through `process`. Downstream: preflight's verdict, the evidence, the agent's revision. Every way
is judged in the same imagined worlds, so that two ways differ by what they do and not by their luck.
"""

from collections import Counter
from dataclasses import dataclass

import msgspec
import mujoco
import numpy as np

from phyagentos.protocol.environment import Environment
from phyagentos.protocol.lookahead import Alternative, LookaheadRequest, LookaheadResult
from phyagentos.protocol.scenes import SceneSpec, read_scene
from phyagentos.protocol.sessions import Ended, Session
from phyagentos.runtime.lookahead.rehearsal import Rehearsal, Rehearser, Stage
from phyagentos.runtime.lookahead.rollouts import find_cause, play
from phyagentos.runtime.lookahead.strategies import Tried, propose
from phyagentos.runtime.lookahead.uncertainty import ImaginedStart, draw_starts

ALTERNATIVES_MAX = 5  # each costs as much as the contract's own way

_INTEGRATION, _FULL = mujoco.mjtState.mjSTATE_INTEGRATION, mujoco.mjtState.mjSTATE_FULLPHYSICS


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
            request: How often, how sure, from which seed.
            tree: Of its skill.
            environment: The estimate.
        """
        clock = self.rehearser.clock
        began_s = clock.now_s()
        spec = read_scene(self.rehearser.library.get_scene(environment.scene))
        stage = self.rehearser.open_stage(environment)
        starts = draw_starts(
            stage.physics,
            stage.start,
            spec,
            environment,
            self.rehearser.profile,
            samples=request.samples,
            seed=request.seed,
        )
        nominal = _copy_start(stage)
        wanted = request.threshold * request.samples
        first, rehearsal = self._try_out(session, stage, tree, [nominal, *starts])
        results, tried = [first], [_tell(first, rehearsal)]
        while results[-1].succeeded < wanted and len(tried) <= ALTERNATIVES_MAX:
            strategy = propose(tried)
            if strategy is None:
                break
            other = msgspec.structs.replace(session, strategy=dict(strategy))
            result, attempt = self._try_out(other, stage, tree, [nominal, *starts], is_other=True)
            results.append(result)
            tried.append(_tell(result, attempt))
        return LookaheadResult(
            samples=request.samples,
            succeeded=first.succeeded,
            threshold=request.threshold,
            causes=first.causes,
            cost_ms=1e3 * (clock.now_s() - began_s),
            notes=_explain(environment, spec, rehearsal),
            alternatives=tuple(sorted(results[1:], key=lambda each: -each.succeeded)),
        )

    def _try_out(
        self, session: Session, stage: Stage, tree: str, starts: list[ImaginedStart], *, is_other: bool = False
    ) -> tuple[Alternative, Rehearsal]:
        """One strategy; the first of the worlds is the one that is believed.

        Another way than the contract's that fails even there is not worth more rollouts.
        """
        rehearsal = self.rehearser.rehearse(stage, session, tree)
        if rehearsal.outcome.ended is not Ended.COMPLETED:
            code = rehearsal.outcome.code or str(rehearsal.outcome.ended).upper()
            return _count(session, [code] * (len(starts) - 1)), rehearsal
        nominal = play(rehearsal, starts[:1], 1)[0]
        if is_other and (cause := find_cause(nominal, nominal, rehearsal)):
            return _count(session, [cause]), rehearsal
        courses = play(rehearsal, starts[1:], self.threads)
        return _count(session, [find_cause(course, nominal, rehearsal) for course in courses]), rehearsal


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
        succeeded=result.succeeded,
        cause=result.likely_cause,
        grasp=rehearsal.find_label("plan_grasp"),
        site=rehearsal.find_label("plan_place"),
    )


def _copy_start(stage: Stage) -> ImaginedStart:
    """The world as believed."""
    model = stage.physics.model
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, stage.start, _INTEGRATION)
    state = np.zeros(mujoco.mj_stateSize(model, _FULL))
    mujoco.mj_getState(model, data, state, _FULL)
    return ImaginedStart(model, state)


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
