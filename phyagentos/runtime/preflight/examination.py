"""The examination of one session: documents, tree, live target, world and dry run, every problem at once.

Nothing moves. The world is observed unless the target is another than its profile; an invalid contract does not hide
its problems.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import msgspec

from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, ExecutionError, Problem
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.placed_scenes import name_plain, read_placed
from phyagentos.protocol.predicates.predicate import find_entities
from phyagentos.protocol.sessions.session import ALREADY_MET, Session
from phyagentos.protocol.settings.perception import Sensing
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.truth import Truth
from phyagentos.runtime.actions.handle import TargetSessionHandle
from phyagentos.runtime.execution.call_check import iter_call_problems
from phyagentos.runtime.execution.criteria import weigh_before
from phyagentos.runtime.execution.first_motions import Grasp
from phyagentos.runtime.execution.leaf_registry import LeafRegistry
from phyagentos.runtime.execution.tree_check import check_tree
from phyagentos.runtime.models.scene_start import OVERLAP, explain_unseen, find_start_problems
from phyagentos.runtime.models.world import Robot
from phyagentos.runtime.motion.process import Planner
from phyagentos.runtime.perception.look import Look
from phyagentos.runtime.perception.world_model import WORLD, WorldModel
from phyagentos.runtime.preflight.adapter_plan import Finding, Trial
from phyagentos.runtime.preflight.compatibility import Preflight
from phyagentos.runtime.preflight.dry_run import (
    ANSWER_S,
    SHARE,
    DryRun,
    compute_reach,
    find_motions,
    make_trial_problem,
)
from phyagentos.runtime.preflight.findings import locate, make_problem
from phyagentos.runtime.preflight.needs import iter_payload_problems
from phyagentos.runtime.targets.wire import Description

_UNMET = "PRECONDITION_UNMET"  # matters to what acts
_UNOBSERVED = "NOT_OBSERVED"
_OTHER_TARGET = frozenset({"TARGET_MISMATCH", "VERSION_MISMATCH"})  # its world is not looked at


@dataclass(slots=True, kw_only=True)
class Examiner:
    """Examines sessions on one target.

    `show_look` keeps the pictures of a look in a folder of evidence, and ends a sentence with their names.
    """

    preflight: Preflight
    handle: TargetSessionHandle
    world: WorldModel
    planner: Planner
    library: Library
    registry: LeafRegistry
    clock: Clock
    show_look: Callable[[Look | None, str], str] = lambda _look, _evidence: ""
    _episode: str = field(default="", init=False)
    _flaws: tuple[Problem, ...] = field(default=(), init=False)

    def examine(
        self, session: Session, *, snapshot: bytes = b"", thorough: bool = False, may_reset: bool = True
    ) -> Finding:
        """Every problem of a session, or its grant.

        A rerun starts at a `snapshot` and gets no dry run, unless it is `thorough`, which looks for paths, too;
        `may_reset` is whether another episode may end for this session.
        """
        began_s = self.clock.now_s()
        loading_s = 0.0
        trials: tuple[Trial, ...] = ()
        held_back: tuple[Problem, ...] = ()
        problems = [*self.preflight.find_contract_problems(session), *self._iter_tree_problems(session)]
        try:
            live = self.handle.describe()
            problems += (mismatches := self.preflight.find_target_problems(session, live))
            problems += (missing := self._find_scene_problems(session))
            is_other = any(problem.code in _OTHER_TARGET for problem in mismatches)
            if not missing and not is_other and session.target == self.preflight.profile.target:
                loading_began_s = self.clock.now_s()
                is_first = session.scene.episode != self._episode and not snapshot
                with ThreadPoolExecutor(1, "flaws") as beside:  # the world loads in another process
                    flaws = beside.submit(self._find_flaws, session) if is_first else None
                    self.handle.load(session.scene, snapshot, may_reset=may_reset)
                loading_s = self.clock.now_s() - loading_began_s
                live = self.handle.describe()  # its cameras belong to the scene
                problems += self._iter_call_problems(session, live)
                problems += self.preflight.find_scene_problems(session, live)
                self._flaws = self._flaws if flaws is None else flaws.result()
                self._episode = session.scene.episode
                found, held_back, trials = self._look(
                    session, live, is_first=is_first, is_tried=thorough or not snapshot, thorough=thorough
                )
                problems += found
        except DefinitionError as error:
            problems += locate(session, error.problems)
        except ExecutionError as error:
            problems.append(Problem(error.code, address=f"{session.id}: target {session.target}", found=str(error)))
        ms = 1e3 * (self.clock.now_s() - began_s - loading_s)
        if problems:
            return Finding(plan=None, tools=None, problems=tuple(dict.fromkeys(problems)), trials=trials, ms=ms)
        plan, tools = self.preflight.plan(session, live)
        plan = msgspec.structs.replace(plan, refused=held_back) if held_back else plan
        return Finding(plan=plan, tools=tools, trials=trials, ms=ms)

    def _look(
        self, session: Session, live: Description, *, is_first: bool, is_tried: bool, thorough: bool
    ) -> tuple[list[Problem], tuple[Problem, ...], tuple[Trial, ...]]:
        """Problems of the world as it stands, those that do not matter if nothing is to be done, and the dry run."""
        self.world.enter(session.scene)
        now = self.world.observe(WORLD)
        found = self.preflight.find_world_problems(session, live, now, is_fresh=is_first)
        problems = [self._tell_unseen(session, now, problem) for problem in found]
        problems += locate(session, self._flaws)
        met = weigh_before(session, now)
        if met is Truth.TRUE and all(each.code == _UNMET for each in problems):
            seen = make_problem(ALREADY_MET, f"{session.id}: accept", "true in preflight, not any more", "true")
            return [], (seen,), ()
        refused, trials = self._find_payload_problems(session), tuple[Trial, ...]()
        if is_tried:
            trials = self._try_out(session, now, live, thorough=thorough)
            impossible = (make_trial_problem(each, session) for each in trials if each.outcome == "impossible")
            refused += locate(session, impossible)
        if met is Truth.UNKNOWN:  # it may rest in its place already
            return problems, tuple(refused), trials
        return [*problems, *refused], (), trials

    def _find_flaws(self, session: Session) -> tuple[Problem, ...]:
        """What is sunk at the start is thrown about: a flaw for every session."""
        if not self.preflight.profile.model:
            return ()
        path = self.library.get_scene(name_plain(session.scene.name))
        found = find_start_problems(path=path, seed=session.scene.seed, robot=self._robot)
        return tuple(each for each in found if each.kind == OVERLAP)

    @property
    def _robot(self) -> Robot:
        profile = self.preflight.profile
        return profile, self.library.get_target(profile.target).parent

    def _tell_unseen(self, session: Session, now: Environment, problem: Problem) -> Problem:
        """What is in the scene and was not seen is not called unknown: where it starts, and why no camera shows it."""
        spec = read_placed(self.library, session.scene.name)
        names = (problem.subject, *find_entities(problem.subject)) if problem.code in {_UNMET, _UNOBSERVED} else ()
        name = next((each for each in names if each in spec.bodies and not now.shows(each)), None)
        if name is None or now.sensing != Sensing.PERCEIVED or not self.preflight.profile.model:
            return problem
        why = explain_unseen(spec, name, session.scene.seed, self._robot, self.preflight.settings.sensors)
        why += self.show_look(self.world.latest_look, f"evidence/{session.id}")
        if problem.code == _UNMET:
            return msgspec.structs.replace(problem, hint=f"{problem.hint}. {why}.")
        found, expected = f"{name!r}, which is in the scene and in no picture", "an object that was seen"
        return msgspec.structs.replace(problem, found=found, expected=expected, hint=f"{why}.")

    def _iter_tree_problems(self, session: Session) -> Iterator[Problem]:
        for tree in self._find_trees(session):
            try:
                yield from check_tree(tree, self.library, self.registry)
            except DefinitionError as error:
                yield from error.problems

    def _iter_call_problems(self, session: Session, live: Description) -> Iterator[Problem]:
        for tree in self._find_trees(session):
            yield from iter_call_problems(tree, self.library, live.procedures, session.target)

    def _find_trees(self, session: Session) -> tuple[str, ...]:
        """The tree of the session's skill, or of each that its agent may direct."""
        known = self.preflight.skills
        skill = known.get(session.skill)
        named = skill.loop.tools if skill is not None and skill.loop is not None else (session.skill,)
        return tuple(known[name].tree for name in named if name in known and known[name].kind == "builtin")

    def _find_scene_problems(self, session: Session) -> list[Problem]:
        try:
            self.library.get_scene(name_plain(session.scene.name))
        except DefinitionError as error:
            return locate(session, error.problems)
        return []

    def _find_payload_problems(self, session: Session) -> list[Problem]:
        skill = self.preflight.skills.get(session.skill)
        if skill is None or not skill.tree or check_tree(skill.tree, self.library, self.registry):
            return []
        motions = find_motions(skill.tree, session.parameters, self.library, self.registry)
        grasped = [motion.object for motion in motions if isinstance(motion, Grasp)]
        if not grasped:
            return []
        return locate(
            session,
            iter_payload_problems(
                grasped, skill, spec=read_placed(self.library, session.scene.name), profile=self.preflight.profile
            ),
        )

    def _try_out(self, session: Session, now: Environment, live: Description, *, thorough: bool) -> tuple[Trial, ...]:
        skill = self.preflight.skills.get(session.skill)
        profile = self.preflight.profile
        if skill is None or not skill.tree or not profile.model:
            return ()
        if check_tree(skill.tree, self.library, self.registry):
            return ()
        dry_run = DryRun(
            planner=self.planner,
            library=self.library,
            registry=self.registry,
            clock=self.clock,
            home_rad=profile.arm.home_rad,
            reach=compute_reach(live.kinematics),
            postures=profile.postures,
            patience_s=min(ANSWER_S, SHARE * session.limits.preflight_s),
        )
        return dry_run.run(session, skill.tree, now, thorough=thorough)
