"""The forecaster `rollouts`: a session is rehearsed as it is and, where that looks bad, with a few other strategies.

Every strategy is judged in the same imagined worlds, so that two of them differ by their effect and not by chance.
"""

import os
from collections import Counter
from dataclasses import dataclass

import msgspec

from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.placed_scenes import read_placed
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.lookahead import ROLLOUTS, Alternative, Forecast, LookaheadRequest
from phyagentos.protocol.sessions.session import Ended, Session
from phyagentos.protocol.sessions.trace import Role, find_label
from phyagentos.protocol.settings.safety import get_target_limits, read_safety
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.scenes import SceneSpec
from phyagentos.runtime.execution.leaf_registry import build_registry
from phyagentos.runtime.lookahead.forecaster import LOOKAHEAD_FAILED, Case, ForecasterSite
from phyagentos.runtime.lookahead.rehearsal import Rehearsal, Rehearser, Stage
from phyagentos.runtime.lookahead.rollouts import Playback, find_cause, is_decided
from phyagentos.runtime.lookahead.strategies import Tried, propose
from phyagentos.runtime.lookahead.uncertainty import ImaginedStart, draw_starts
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.process import LocalPlanner
from phyagentos.runtime.motion.tool_bounds import read_tool_bounds

ALTERNATIVES_MAX = 5  # each costs as much as the contract's own way
BATCH = 2  # rollouts between two looks at their count, whatever the number of threads


@dataclass(frozen=True, slots=True, kw_only=True)
class RolloutForecaster:
    """Foresees sessions by simulation, with so many threads."""

    rehearser: Rehearser
    threads: int = 1
    name: str = ROLLOUTS

    def forecast(self, case: Case) -> Forecast:
        """How often the session meets its contract from the estimate on, carried out by the tree of its skill.

        Raises ExecutionError `LOOKAHEAD_FAILED` without a tree.
        """
        session, request, environment = case.session, case.request, case.environment
        if not case.tree:
            raise ExecutionError(LOOKAHEAD_FAILED, f"skill {session.skill!r} is no tree, so it cannot be rehearsed")
        spec = read_placed(self.rehearser.library, environment.scene)
        stage = self.rehearser.open_stage(environment)
        worlds = _Worlds(stage, spec, environment, self.rehearser.profile, request)
        first, rehearsal = self._try_out(session, worlds, case.tree)
        results, tried = [first], [_describe(first, rehearsal)]
        while results[-1].share < request.threshold and len(tried) <= ALTERNATIVES_MAX:
            if (strategy := propose(tried)) is None:
                break
            other = msgspec.structs.replace(session, strategy=strategy)
            result, attempt = self._try_out(other, worlds, case.tree, is_other=True)
            results.append(result)
            tried.append(_describe(result, attempt))
        return Forecast(
            samples=first.samples,
            succeeded=first.succeeded,
            causes=first.causes,
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


def open_rollouts(site: ForecasterSite) -> RolloutForecaster:
    """The forecaster, with a planner of its own; takes seconds, in which that is compiled."""
    workspace, target = site.workspace, site.target
    library = workspace.library()
    path = library.get_target(target)
    profile, folder = read_profile(path)
    limits = get_target_limits(read_safety(workspace.safety), target, str(workspace.safety))
    planner = MotionPlanner.open(path, bounds=read_tool_bounds(limits))
    planner.warm_up()
    rehearser = Rehearser(
        profile=profile,
        folder=folder,
        limits=limits,
        library=library,
        registry=build_registry(library),
        planner=LocalPlanner(planner),
        clock=SystemClock(),
    )
    return RolloutForecaster(rehearser=rehearser, threads=len(os.sched_getaffinity(0)))


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
