"""Answers motion requests for one robot.

An answer depends on its request alone; models and compiled scenes kept between requests never change it.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import chain, combinations
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from phyagentos.clock import Clock, SystemClock
from phyagentos.errors import format_hint, format_names
from phyagentos.geometry import compute_matrix, compute_pose
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.documents.schema import read_yaml, validate
from phyagentos.protocol.sessions.trace import Contact
from phyagentos.protocol.world.environment import Entity, Pose, Shape, ShapeKind
from phyagentos.runtime.motion.approaches import find_touch
from phyagentos.runtime.motion.calls import counting_calls
from phyagentos.runtime.motion.chain import build_chain
from phyagentos.runtime.motion.grasps import find_grasps
from phyagentos.runtime.motion.job import Cancelled, Job
from phyagentos.runtime.motion.kinematics import Kinematics
from phyagentos.runtime.motion.moves import TimeRows, find_escape, follow_waypoints, plan_move
from phyagentos.runtime.motion.neighbours import NeighbourModel
from phyagentos.runtime.motion.placements import find_placements
from phyagentos.runtime.motion.planning_scene import PlanningScene, PlanningScenes
from phyagentos.runtime.motion.pushes import find_push
from phyagentos.runtime.motion.requests import (
    Approach,
    Approaches,
    CheckPosture,
    FindGrasps,
    FindLine,
    FindPlacements,
    FindPush,
    FindTouch,
    Load,
    Motion,
    MotionAnswer,
    MotionRequest,
    NoPlan,
    Payload,
    PlanMove,
    PostureCheck,
    ShapeTransport,
    Stages,
    TimeLine,
    World,
)
from phyagentos.runtime.motion.robot_model import build_robot_model
from phyagentos.runtime.motion.shapes import foresee_payload
from phyagentos.runtime.motion.sphere_checker import SphereChecker
from phyagentos.runtime.motion.sphere_model import SphereModel
from phyagentos.runtime.motion.timing import JointLimits, time_path
from phyagentos.runtime.motion.tool_bounds import ANYWHERE, ToolBounds

REMOVED_MAX = 2  # entities that are moved out for one that comes in

_Placed = FindGrasps | FindPlacements | FindLine | FindPush | FindTouch | PlanMove | CheckPosture


class MotionPlanner:
    """The motion functions of one robot; the clock only measures stages."""

    def __init__(
        self,
        profile: TargetProfile,
        folder: Path,
        clock: Clock | None = None,
        bounds: ToolBounds = ANYWHERE,
        neighbours: Mapping[str, Path] | None = None,
        speed: float = 1.0,
    ) -> None:
        self._clock = clock or SystemClock()
        self.robot = build_robot_model(profile, folder, bounds)
        self._chain = build_chain(self.robot)
        self._kinematics = Kinematics(self.robot, self._chain)
        self._spheres = SphereModel(self.robot, self._chain)
        self._scenes = PlanningScenes(self.robot)
        self._limits = JointLimits.from_profile(profile).scale(speed, speed**2)
        self._neighbours = {name: NeighbourModel(file) for name, file in (neighbours or {}).items()}

    @classmethod
    def open(
        cls,
        profile_file: Path,
        bounds: ToolBounds = ANYWHERE,
        neighbours: Mapping[str, Path] | None = None,
        speed: float = 1.0,
    ) -> "MotionPlanner":
        """The planner of `robots/<name>/target.yaml`, whose tool centre point stays within `bounds`.

        `neighbours` are the profiles of other robots of its world, by name; motions use `speed`, a share of the limits.
        """
        profile = validate(TargetProfile, read_yaml(profile_file))
        return cls(profile, profile_file.parent, bounds=bounds, neighbours=neighbours, speed=speed)

    def answer(self, request: MotionRequest, should_cancel: Callable[[], bool] = lambda: False) -> MotionAnswer:
        """Carry out one request.

        Once `should_cancel`, polled often, is true, the answer becomes `NoPlan` with code CANCELLED.
        """
        job = Job(clock=self._clock, should_cancel=should_cancel)
        with counting_calls() as calls:
            try:
                answer = self._find_unknown(request, job) or self._dispatch(request, job)
            except Cancelled:
                answer = job.fail("CANCELLED", "The request was cancelled.")
        answer = replace(answer, stages=replace(answer.stages, calls=dict(calls)))
        if not isinstance(answer, NoPlan):
            return answer
        return replace(answer, neighbours=tuple(sorted(job.crowded_by)))

    def warm_up(self, before_paths: Callable[[], object] = lambda: None) -> None:
        """Load or compile every kernel and library, so that the first request is as fast as later ones.

        `before_paths` is called when those of kinematics are loaded, before those that test a path.
        """
        shapes = (Shape(ShapeKind.BOX, (0.02, 0.02, 0.02)),)
        cube = Entity(name="cube", kind="cube", pose=Pose((0.5, 0.0, 0.02)), shapes=shapes)
        home = self.robot.home_rad
        world = World((cube,))
        self.answer(FindGrasps(world=world, object="cube", q_rad=home, seed=0, count=1))
        before_paths()
        held = Payload("cube", Pose(), load=Load(0.1, (0.0, 0.0, 0.0), 0.02, 0.4, 20.0))
        self.answer(PlanMove(world=world, q_rad=home, goals_rad=home[None] + 0.1, seed=0, payload=held))

    def _dispatch(self, request: MotionRequest, job: Job) -> MotionAnswer:
        match request:
            case FindGrasps():
                return self._find_grasps(request, job)
            case FindPlacements():
                held = _get_entity(request.world, request.payload.entity)
                return find_placements(request, held, self._kinematics, self._get_scene(request, job), job)
            case FindPush():
                pushed = _get_entity(request.world, request.object)
                return find_push(request, pushed, self._kinematics, self._get_scene(request, job), job)
            case FindTouch():
                lead_on = partial(self._pull, request, (request.object, *request.ignore), request.width_m, job)
                return find_touch(request, self._kinematics, self._get_scene(request, job), job, lead_on)
            case FindLine():
                scene = self._get_scene(request, job)
                return follow_waypoints(request.q_rad, request.waypoints, "line", self._kinematics, scene, job)
            case PlanMove():
                load = None if request.payload is None else request.payload.load
                time_rows = self._get_timer(self._limits.scale(request.speed, request.speed**2), load)
                return plan_move(request, self._get_scene(request, job), self._spheres, time_rows, job)
            case CheckPosture():
                return self._check_posture(request, job)
            case TimeLine():
                limits = self._limits.scale(request.speed, request.speed)
                with job.stage("timing"):
                    rows = np.asarray(request.waypoints_rad, dtype=float)
                    timed = self._get_timer(limits, request.load, keeps_toppra=True)(rows)
                stages = Stages(scaling=timed.scaling)
                return Motion(trajectory=timed.trajectory, goal=0, timing=job.timing, stages=stages)
            case ShapeTransport():
                from phyagentos.runtime.motion.transport import shape_transport  # casadi: only where it is used

                return shape_transport(request, self._chain, self._limits, job)

    def _get_timer(self, limits: JointLimits, load: Load | None, *, keeps_toppra: bool = False) -> TimeRows:
        if load is None:
            return lambda rows: time_path(rows, limits)
        from phyagentos.runtime.motion.transport import CarryConstraints, time_carry  # casadi: only where it is used

        return lambda rows: time_carry(rows, limits, self._chain, CarryConstraints(load), keeps_toppra=keeps_toppra)

    def _find_grasps(self, request: FindGrasps, job: Job) -> Approaches | NoPlan:
        """Grasps, and the first removable entities without which the object has a place."""
        entity = _get_entity(request.world, request.object)
        then = None if request.removable else request.then  # one grasp shows what has to go
        place = partial(self._place, replace(request, then=then), entity, job)
        found = find_grasps(request, entity, self._kinematics, self._get_scene(request, job), job, place)
        if isinstance(found, NoPlan) or not request.removable:
            return found
        for gone in self._iter_removals(request, job):
            left = tuple(each for each in request.world.entities if each.name not in gone)
            world = replace(request.world, entities=left)
            placed = self._place(replace(request, world=world), entity, job, found.approaches[0])
            if not isinstance(placed, NoPlan):
                return replace(found, gone=gone)
            if placed.code == "NO_SPACE":
                break  # not even where nothing else is
        return job.fail("NO_FREE_SITE", f"{entity.name} has no room without {format_names(request.removable)}.")

    def _iter_removals(self, request: FindGrasps, job: Job) -> Iterator[tuple[str, ...]]:
        """Nothing, then one entity, then two, of those that the hand can take."""
        yield ()
        alone = replace(request, removable=(), then=None, count=1)
        asked = [(name, self._find_grasps(replace(alone, object=name), job)) for name in request.removable]
        takeable = [name for name, answer in asked if isinstance(answer, Approaches)]
        yield from chain(*(combinations(takeable, count) for count in range(1, REMOVED_MAX + 1)))

    def _place(self, request: FindGrasps, entity: Entity, job: Job, approach: Approach) -> Approaches | NoPlan | None:
        """A way to put down what is grasped so; None where it is not known where to."""
        if request.moves:
            width_m = foresee_payload(entity, approach).width_m
            return self._pull(request, (entity.name, entity.part_of), width_m, job, approach)
        if request.then is None:
            return None
        placing = FindPlacements(
            world=request.world,
            payload=foresee_payload(entity, approach),
            destination=request.then.name,
            relation=request.then.relation,
            near=request.then.near,
            near_radius_m=request.then.near_radius_m,
            up=request.then.up,
            heading_rad=request.then.heading_rad,
            q_rad=approach.line_rad[0],
            seed=request.seed,
            count=1,
        )
        own = Job(clock=self._clock, should_cancel=job.should_cancel)
        if self._find_unknown(placing, own):
            return None
        with job.stage("place"):
            return find_placements(placing, entity, self._kinematics, self._get_scene(placing, own), own)

    def _pull(
        self, request: FindGrasps | FindTouch, ignore: tuple[str, ...], width_m: float, job: Job, approach: Approach
    ) -> Approaches | NoPlan:
        """The line of a hand that has come so, while what it moves is ignored."""
        tool = compute_matrix(approach.tcp_end)
        waypoints = tuple(compute_pose(move @ tool) for move in request.moves)
        q_rad, own = approach.line_rad[-1], Job(clock=self._clock, should_cancel=job.should_cancel)
        line = FindLine(request.world, q_rad, request.seed, waypoints, ignore=ignore, width_m=width_m)
        with job.stage("place"):
            return follow_waypoints(q_rad, waypoints, "line", self._kinematics, self._get_scene(line, own), own)

    def _check_posture(self, request: CheckPosture, job: Job) -> PostureCheck:
        scene = self._get_scene(request, job)
        with job.stage("check"):
            q_rad = np.asarray(request.q_rad, dtype=float)
            pairs = scene.find_contacts(q_rad)
            escapes = not pairs or find_escape(q_rad, pairs, scene, request.seed) is not None
        return PostureCheck(contacts=tuple(str(Contact(*pair)) for pair in pairs), escapes=escapes, timing=job.timing)

    def _get_scene(self, request: _Placed, job: Job) -> PlanningScene:
        payload = None if isinstance(request, FindGrasps | FindPush | FindTouch | CheckPosture) else request.payload
        ignore = () if isinstance(request, FindGrasps | FindPlacements) else request.ignore
        if isinstance(request, FindPush | FindTouch):
            ignore = (request.object, *ignore)
        with job.stage("model"):
            scene = self._scenes.get_scene(request.world, payload, ignore)
            width_m = request.width_m if isinstance(request, FindLine | FindPush | FindTouch | PlanMove) else None
            if payload is None and width_m is not None:
                scene.spread_fingers(width_m, width_m)
            self._add_neighbours(request, scene)
            scene.crowded_by = job.crowded_by
            return scene

    def _add_neighbours(self, request: _Placed, scene: PlanningScene) -> None:
        """Let the other robots stand in the scene; where a grasp or a place is chosen, only those that are met there.

        The others may have moved on until then.
        """
        is_choice = isinstance(request, FindGrasps | FindPlacements)
        near = [each for each in request.world.neighbours if each.is_met or not is_choice]
        there = [each for each in near if each.name in self._neighbours]
        if not there:
            return
        own = self._spheres.build_arrays(scene)
        for each in there:
            groups = scene.crowd[each.name] = self._neighbours[each.name].cover(each, request.world.entities)
            scene.crowd_checks[each.name] = SphereChecker(own.meet_only(groups)).is_free

    def _find_unknown(self, request: MotionRequest, job: Job) -> NoPlan | None:
        """Refusal of a request that names an entity without solids or an unknown place."""
        if isinstance(request, TimeLine | ShapeTransport | CheckPosture):
            return None
        solid = [entity.name for entity in request.world.entities if entity.shapes]
        places = [*solid, *(region.name for region in request.world.regions)]
        wanted: list[tuple[str, list[str]]] = []
        if isinstance(request, FindGrasps | FindPush | FindTouch):
            wanted.append((request.object, solid))
        else:
            wanted += [(request.payload.entity, solid)] if request.payload else []
            wanted += [(request.destination, places)] if isinstance(request, FindPlacements) else []
        for name, known in wanted:
            if name not in known:
                hint = format_hint(name, known)
                return job.fail("OBJECT_GONE", f"There is no {name!r} among {format_names(known)}. {hint}".strip())
        return None


def _get_entity(world: World, name: str) -> Entity:
    return next(entity for entity in world.entities if entity.name == name)
