"""The forecaster `rollouts`: a session is rehearsed as it is and, where that looks bad, with a few other strategies.

Every strategy is judged in the same imagined worlds, so that two of them differ by their effect and not by chance.
The search among them is greedy: the next is a remedy for the best one so far, by its most frequent cause.
"""

import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import msgspec

from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.placed_scenes import read_placed
from phyagentos.protocol.sessions.lookahead import ROLLOUTS, Alternative, Forecast
from phyagentos.protocol.sessions.session import Ended, Session
from phyagentos.protocol.sessions.strategy import SiteLabel, Strategy
from phyagentos.protocol.sessions.trace import Role, find_label
from phyagentos.protocol.settings.safety import get_target_limits, read_safety
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.scenes import SceneSpec
from phyagentos.runtime.execution.leaf_registry import build_registry
from phyagentos.runtime.lookahead.forecaster import LOOKAHEAD_FAILED, Case, ForecasterSite
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.process import LocalPlanner
from phyagentos.runtime.motion.tool_bounds import read_tool_bounds
from rollout_forecaster.playback import Playback, find_cause, is_decided
from rollout_forecaster.rehearsal import Rehearsal, Rehearser, Stage
from rollout_forecaster.uncertainty import ImaginedStart, draw_start

ALTERNATIVES_MAX = 5  # each costs as much as the contract's own way
BATCH = 2  # rollouts between two looks at their count, whatever the number of threads
SLOWER = 0.5  # at half the speed inertia is a quarter
SLOWEST = 0.125  # a session that creeps meets its time limit instead

Draw = Callable[[int], ImaginedStart]


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

        @cache
        def draw(number: int) -> ImaginedStart:
            profile, seed = self.rehearser.profile, request.seed
            return draw_start(stage.physics, stage.start, spec, environment, profile, seed=seed, number=number)

        first, rehearsal = self._try_out(case, session, stage, draw)
        results, tried = [first], [_describe(first, rehearsal)]
        while results[-1].share < request.threshold and len(tried) <= ALTERNATIVES_MAX:
            if (strategy := propose(tried)) is None:
                break
            other = msgspec.structs.replace(session, strategy=strategy)
            result, attempt = self._try_out(case, other, stage, draw, is_other=True)
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
        self, case: Case, session: Session, stage: Stage, draw: Draw, *, is_other: bool = False
    ) -> tuple[Alternative, Rehearsal]:
        """One strategy, in as many worlds as the decision takes; they are drawn on demand and shared by all.

        A strategy that fails even in the world as believed needs no rollouts; nor does an alternative that fails there.
        """
        rehearsal = self.rehearser.rehearse(stage, session, case.tree)
        if rehearsal.outcome.ended is not Ended.COMPLETED:
            return _count(session, [rehearsal.outcome.code or str(rehearsal.outcome.ended).upper()]), rehearsal
        request, playback = case.request, Playback(rehearsal, self.threads)
        nominal = playback.nominal
        if is_other and (cause := find_cause(nominal, nominal, rehearsal)):
            return _count(session, [cause]), rehearsal
        causes: list[str] = []
        while not causes or not is_decided(causes.count(""), len(causes), request.threshold, request.samples):
            numbers = range(len(causes), min(len(causes) + BATCH, request.samples))
            rollouts = playback.play([draw(number) for number in numbers])
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


def _count(session: Session, causes: list[str]) -> Alternative:
    """Rollouts of one strategy, counted; an empty cause is a success."""
    failures = Counter(cause for cause in causes if cause)
    return Alternative(
        strategy=session.strategy,
        samples=len(causes),
        succeeded=len(causes) - failures.total(),
        causes=dict(sorted(failures.items())),
    )


def _describe(result: Alternative, rehearsal: Rehearsal) -> "Tried":
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


class Tried(NamedTuple):
    """A strategy that was rehearsed.

    Attributes:
        share: Of its rollouts, that met the contract, 0..1.
    """

    strategy: Strategy
    share: float
    cause: str
    grasp: str
    site: str


def propose(tried: Sequence[Tried]) -> Strategy | None:
    """The next strategy worth a rehearsal; None when nothing is left to try."""
    known = {each.strategy for each in tried}
    for each in sorted(tried, key=lambda each: -each.share):
        for remedy in _REMEDIES.get(each.cause, ()):
            strategy = remedy(each)
            if strategy not in known:
                return strategy
    return None


def _go_slower(tried: Tried) -> Strategy:
    return tried.strategy.slow_down(SLOWER, SLOWEST)


def _grasp_otherwise(tried: Tried) -> Strategy:
    return tried.strategy.avoid(grasp=tried.grasp)


def _arrive_otherwise(tried: Tried) -> Strategy:
    """The same place from another side."""
    return tried.strategy.avoid(site=tried.site)


def _place_elsewhere(tried: Tried) -> Strategy:
    return tried.strategy.avoid(site=SiteLabel.parse(tried.site).site)


_Remedies = tuple[Callable[[Tried], Strategy], ...]
_UNPLANNED: _Remedies = (_grasp_otherwise, _place_elsewhere, lambda tried: tried.strategy.avoid_nothing())
_REMEDIES: Mapping[str, _Remedies] = {
    "GRASP_MISSED": (_grasp_otherwise,),
    "GRASP_LOST": (_go_slower, _grasp_otherwise),
    "LOAD_LOST": (_go_slower, _grasp_otherwise, _place_elsewhere),
    "PLACED_WRONG": (_place_elsewhere, _go_slower, _grasp_otherwise),
    "OBJECT_MOVED": (_arrive_otherwise, _place_elsewhere, _grasp_otherwise, _go_slower),
    "WITHOUT_EFFECT": (_grasp_otherwise,),
    "CONSTRAINT_VIOLATED": (_go_slower, _place_elsewhere, _grasp_otherwise),
    "STILL_HELD": (_place_elsewhere,),
    **dict.fromkeys(("STALLED", "PROTECTIVE_STOP"), (_go_slower,)),
    **dict.fromkeys(("COLLISION_STOP", "TARGET_LIMIT"), (_grasp_otherwise, _place_elsewhere, _go_slower)),
    **dict.fromkeys(("NO_IK", "IN_COLLISION", "NO_PLAN", "NO_FREE_SITE"), _UNPLANNED),
}
