"""A dry run: whether the first motions of a skill can exist in the world as it stands. Nothing moves.

Three answers: possible, impossible, undecided; only what is proved impossible rejects a session. A search that found no
way within its budget is no proof.
"""

from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, Problem, blaming
from phyagentos.geometry import to_parent
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.trees import Node, NodeKind, Reference, read_tree
from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.meaning import Statement, read_statement
from phyagentos.protocol.predicates.predicate import find_formula
from phyagentos.protocol.predicates.syntax import Name, Point
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.sessions.trace import Contact
from phyagentos.protocol.world.entity_geometry import find_tops_below
from phyagentos.protocol.world.environment import Entity, Environment
from phyagentos.runtime.execution.context import compute_leaf_seed
from phyagentos.runtime.execution.first_motions import FirstMotion, Foreseen, Grasp, Home, Onward
from phyagentos.runtime.execution.leaf_registry import LeafRegistry
from phyagentos.runtime.execution.leaves.plan_room import list_removable
from phyagentos.runtime.motion.process import Planner
from phyagentos.runtime.motion.requests import (
    GRASPS,
    Approaches,
    CheckPosture,
    Destination,
    FindGrasps,
    FindPlacements,
    MotionAnswer,
    MotionRequest,
    NoPlan,
    Payload,
    PlanMove,
    PostureCheck,
    TimeLine,
    World,
)
from phyagentos.runtime.motion.shapes import foresee_payload
from phyagentos.runtime.motion.tool_bounds import is_wall
from phyagentos.runtime.preflight.adapter_plan import Trial
from phyagentos.runtime.preflight.findings import make_problem
from phyagentos.runtime.targets.wire import Kinematics

FORESEE_S = 5.0  # for a person's leaf to say what it does first, by the wall clock
CANDIDATES = 1  # one way is enough to know that there is one
ANSWER_S = 60.0  # by the wall clock; at the first session the planner may still be starting
SHARE = 0.5  # of the time that the contract allows the whole examination
PATH_SPEED = 1.0
NUDGE_RAD = 0.01  # the shortest line that there is to time
AROUND_M = 0.3  # tolerance of a place, and half of what is pushed there
HAND_M = 0.05  # a tool point that grasps an object is this near to its solids at most
PROOFS = {  # codes of the planner that prove a motion impossible -> code of the problem
    "NOT_GRASPABLE": "NOT_GRASPABLE",
    "NO_SPACE": "NO_SPACE",
    "NO_FREE_SITE": "NO_FREE_SITE",
    "OBJECT_GONE": "NOT_OBSERVED",
}
ON_AXIS_M = 1e-6


@dataclass(frozen=True, slots=True)
class Reach:
    """A ball in the world that holds every point where the tool centre point can be: a proof, not an estimate."""

    center_m: tuple[float, float, float]
    radius_m: float

    def compute_excess(self, point_m: tuple[float, ...]) -> float:
        """How far a point (3,) lies outside [m]; not positive inside."""
        return float(np.linalg.norm(np.asarray(point_m) - self.center_m)) - self.radius_m


def compute_reach(kinematics: Kinematics | None) -> Reach | None:
    """The smallest such ball about an anchor that no joint moves; None when a joint slides, or without kinematics.

    No posture brings the tool further from a joint's anchor than the sum of the links after it.
    """
    if kinematics is None or any(kinematics.slides):
        return None
    axes, anchors = np.asarray(kinematics.axes), np.asarray(kinematics.anchors_m)
    first = 0
    while first + 1 < len(anchors) and all(
        np.linalg.norm(np.cross(axes[k], anchors[first + 1] - anchors[k])) < ON_AXIS_M for k in range(first + 1)
    ):
        first += 1  # the next anchor lies on every axis before it, so that it never moves
    points = np.vstack((anchors[first:], np.asarray(kinematics.tcp_m)[None]))
    x, y, z = anchors[first].tolist()
    return Reach((x, y, z), float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum()))


Motions = Generator[FirstMotion, None, bool]


@dataclass(slots=True, kw_only=True)
class _Course:
    """A dry run so far: where the arm would stand, in which world, with what in its hand.

    Attributes:
        known: Where that can surely be put down.
    """

    session: Session
    now: Environment
    world: World
    q_rad: NDArray[np.float64]
    thorough: bool
    grasped: Payload | None = None
    known: Destination | None = None
    trials: list[Trial] = field(default_factory=list)


@dataclass(frozen=True, slots=True, kw_only=True)
class DryRun:
    """Sends the planner of the worker, idle between sessions, the requests of the tree.

    Attributes:
        registry: Where leaves declare their roles.
        home_rad: (n_joints,) posture before a session [rad].
        postures: Those that the target's profile names [rad].
        reach: Bound on the tool; None without one.
        patience_s: Longest wait for one answer, by the wall clock [s]; then it decides nothing.
    """

    planner: Planner
    library: Library
    registry: LeafRegistry
    clock: Clock
    home_rad: tuple[float, ...]
    reach: Reach | None
    postures: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    patience_s: float = ANSWER_S

    def run(self, session: Session, tree: str, now: Environment, *, thorough: bool) -> tuple[Trial, ...]:
        """Check the first posture of the arm; try the first grasp and the place that follows it.

        A `thorough` run also searches a collision-free path to the grasp; it costs more and never rejects.
        """
        state = now.targets.get(session.target)
        course = _Course(
            session=session,
            now=now,
            world=World(tuple(now.entities.values()), tuple(now.regions.values())),
            q_rad=np.asarray(state.q_rad if state is not None else self.home_rad, dtype=np.float64),
            thorough=thorough,
        )
        if thorough:
            self._ask(TimeLine(waypoints_rad=np.stack((course.q_rad, course.q_rad + NUDGE_RAD))))
        start = self._try_posture(course, "start", course.q_rad)  # the planner is ready: the costs are its own
        if start.outcome != "possible" or thorough:
            course.trials.append(start)
        course.trials += self._iter_beyond(session)
        motions = find_motions(tree, session.parameters, self.library, self.registry)
        all(self._try(course, motion) for motion in motions)
        return tuple(course.trials)

    def _try(self, course: _Course, motion: FirstMotion) -> bool:
        """Whether what follows can be tried, too."""
        match motion:
            case Home():
                self._go_home(course, motion)
            case Grasp():
                return self._take(course, motion)
            case _ if course.grasped is not None:
                self._put_down(course, motion, course.grasped)
        return True

    def _go_home(self, course: _Course, motion: Home) -> None:
        asked_rad = self.postures.get(motion.posture, self.home_rad)
        goal_rad = np.append(course.q_rad[: len(course.q_rad) - len(asked_rad)], asked_rad)  # a base stays
        if float(np.abs(goal_rad - course.q_rad).max()) > NUDGE_RAD:
            course.trials.append(self._try_posture(course, motion.posture, goal_rad))
            course.q_rad = goal_rad

    def _take(self, course: _Course, motion: Grasp) -> bool:
        entity = course.now.entities.get(motion.object)
        if entity is None or entity.held_by:
            return False  # reported with the names; where it lies once it is let go is not known
        if motion.removable is not None:
            self._make_room(course, motion, entity)
            return True
        trial, answer = self._try_grasp(course, motion, entity)
        course.trials.append(trial)
        if not isinstance(answer, Approaches):
            return False
        way, then = answer.approaches[0], motion.then
        is_known = answer.leads_on and then is not None and then.relation == Meaning.INSIDE
        course.known = then if is_known else None  # what it stands on has to have a face
        if course.thorough:
            request = PlanMove(course.world, course.q_rad, course.session.seed, way.line_rad[:1], speed=PATH_SPEED)
            course.trials.append(_judge(f"path to {motion.object}", *self._ask(request), proves=False))
        course.grasped, course.q_rad = foresee_payload(entity, way), way.line_rad[-1]
        return True

    def _make_room(self, course: _Course, motion: Grasp, entity: Entity) -> None:
        """The world without what the tree moves out; where nothing gives room, what follows says so."""
        to = motion.then.name if motion.then is not None else ""
        if removable := list_removable(course.session, course.now, motion.object, to):
            _, room = self._try_grasp(course, replace(motion, removable=removable), entity)
            gone = room.gone if isinstance(room, Approaches) else ()
            course.world = World(
                entities=tuple(each for each in course.world.entities if each.name not in gone),
                regions=course.world.regions,
            )

    def _put_down(self, course: _Course, to: Destination, payload: Payload) -> None:
        name = f"place {payload.entity} {to.relation} {to.name}"
        if to == course.known and not course.session.strategy.avoid_sites:
            course.trials.append(Trial(motion=name, outcome="possible"))
        else:
            course.trials.append(self._try_place(course, to, payload, name))

    def _iter_beyond(self, session: Session) -> Iterator[Trial]:
        """Points where the acceptance wants an object, and where no tool brings anything; heights do not matter."""
        for text in session.accept:
            match read_statement(find_formula(text)), self.reach:
                case Statement(Meaning.AT, Name(item), Point((x_m, y_m, _))), Reach() as reach:
                    excess_m = reach.compute_excess((x_m, y_m, reach.center_m[2])) - AROUND_M
                    name = f"{item} to ({x_m:g}, {y_m:g})"
                    message = f"the point lies {excess_m:.3f} m beyond the longest reach of {session.target}"
                    if excess_m > 0.0:
                        yield Trial(motion=name, outcome="impossible", code="OUT_OF_REACH", message=message)

    def _try_posture(self, course: _Course, name: str, q_rad: NDArray[np.float64]) -> Trial:
        """Contacts of the arm with itself and with fixed entities, where it stands or where the tree sends it.

        A contact at the start is left if there is a short way out; the tree never leads into one.
        """
        answer, ms = self._ask(
            CheckPosture(
                course.world,
                q_rad,
                course.session.seed,
                ignore=tuple(each.name for each in course.world.entities if each.movable),
            )
        )
        if not isinstance(answer, PostureCheck):
            return _judge(f"{name} posture", answer, ms, proves=False)
        if not answer.contacts:
            return Trial(motion=f"{name} posture", outcome="possible", ms=ms)
        is_proved = name != "start" or not answer.escapes
        message = f"in this posture {', '.join(answer.contacts)} touch" + ("" if is_proved else "; there is a way out")
        outcome: Literal["impossible", "undecided"] = "impossible" if is_proved else "undecided"
        return Trial(motion=f"{name} posture", outcome=outcome, code="IN_COLLISION", message=message, ms=ms)

    def _try_grasp(self, course: _Course, motion: Grasp, entity: Entity) -> tuple[Trial, MotionAnswer | None]:
        name, session = f"grasp {motion.object}", course.session
        excess_m = self._compute_excess(entity)
        if excess_m > 0.0:
            return Trial(
                motion=name,
                outcome="impossible",
                code="OUT_OF_REACH",
                message=f"{motion.object} lies {excess_m:.3f} m beyond the longest reach of {session.target}",
            ), None
        request = FindGrasps(
            world=course.world,
            object=motion.object,
            q_rad=course.q_rad,
            seed=compute_leaf_seed(session, motion.leaf),
            avoid=session.strategy.avoid_grasps,
            count=CANDIDATES if motion.removable else GRASPS,
            then=motion.then,
            removable=motion.removable or (),
        )
        answer, ms = self._ask(request)
        return _judge(name, answer, ms), answer

    def _try_place(self, course: _Course, to: Destination, payload: Payload, name: str) -> Trial:
        place = course.now.entities.get(to.name) or course.now.regions.get(to.name)
        if place is None:
            return Trial(motion=name, outcome="undecided", message="the destination is not in the world as observed")
        if to.relation == Meaning.ON and isinstance(place, Entity) and not _has_face(place):
            return Trial(
                motion=name,
                outcome="impossible",
                code="NO_SPACE",
                message=f"{to.name} has no level face on which anything could stand",
            )
        request = FindPlacements(
            world=course.world,
            payload=payload,
            destination=to.name,
            q_rad=course.q_rad,
            seed=course.session.seed,
            relation=to.relation,
            near=to.near,
            avoid=course.session.strategy.avoid_sites,
            count=CANDIDATES,
        )
        answer, ms = self._ask(request)
        return _judge(name, answer, ms)

    def _ask(self, request: MotionRequest) -> tuple[MotionAnswer | None, float]:
        """The planner's answer, None when it is too slow or gone; and its cost [ms]."""
        began_s = self.clock.now_s()
        self.planner.submit(request)
        answer = None
        while answer is None and (left_s := began_s + self.patience_s - self.clock.now_s()) > 0.0:
            self.planner.wait(left_s)
            answer = self.planner.poll()
        if answer is None:
            self.planner.cancel()
        return answer, 1e3 * (self.clock.now_s() - began_s)

    def _compute_excess(self, entity: Entity) -> float:
        """Distance of an entity beyond every grasp of it [m]."""
        if self.reach is None:
            return 0.0
        norm = np.linalg.norm  # of balls about the entity's origin that hold its shapes
        own_m = max((float(norm(each.pose.position_m) + norm(each.size_m)) for each in entity.shapes), default=0.0)
        return self.reach.compute_excess(entity.pose.position_m) - own_m - HAND_M


def _has_face(entity: Entity) -> bool:
    """Whether `on` can ever be true of it: a solid has a level top; of what has no known solid that is not known."""
    middles = (to_parent(entity.pose, shape.pose.position_m) for shape in entity.shapes)
    return not entity.shapes or any(find_tops_below(entity, x_m, y_m, 0.0) for x_m, y_m, _ in middles)


def find_motions(
    tree: str,
    arguments: Mapping[str, Any],
    library: Library,
    registry: LeafRegistry,
    within: tuple[str, ...] = (),
    path: str = "",
) -> Motions:
    """The grasp that a tree surely begins with, and the place that surely follows it.

    After a fallback, a retry or any other control node nothing is sure: its children may not be reached, or not in this
    world. The same holds after the place, or after a leaf without a known role.

    Returns:
        Whether the whole tree was examined, so that what follows it is as sure.
    """
    try:
        authored = read_tree(library.get_tree(tree))
    except DefinitionError:
        return False  # reported by the check of trees
    known = {name: port.default for name, port in authored.header.inputs.items() if port.default is not None}
    known |= {name: value for name, value in arguments.items() if value is not None}
    return (yield from _find_in(authored.root, known, library, registry, (*within, tree), path or tree))


def _find_in(
    node: Node, known: Mapping[str, Any], library: Library, registry: LeafRegistry, within: tuple[str, ...], path: str
) -> Motions:
    children = node.children if node.kind is NodeKind.SEQUENCE else (node,)
    for child in children:
        wired = {
            port: known.get(value.key) if isinstance(value, Reference) else value
            for port, value in child.wiring.items()
        }
        where = path if child is node else f"{path}/{child.name}"
        if child.kind is NodeKind.SUBTREE and child.type not in within:
            if not (yield from find_motions(child.type, wired, library, registry, within, where)):
                return False
            continue
        leaf = registry.find(child.type) if child.kind is NodeKind.LEAF else None
        foreseen = Foreseen(onward=Onward.OPEN)
        if leaf is not None:
            with blaming(f"{leaf.__name__}.foresee", leaf, leaf.foresee, limit_s=FORESEE_S):
                foreseen = leaf.foresee(wired, where)
                if not isinstance(foreseen, Foreseen):
                    raise TypeError(f"it answered {foreseen!r:.80}; expected a Foreseen")
        if foreseen.motion is not None:
            yield foreseen.motion
        if foreseen.onward is not Onward.SURE:
            return foreseen.onward is Onward.OUTSIDE
    return True


def make_trial_problem(trial: Trial, session: Session) -> Problem:
    """Why a session is rejected whose first motion cannot exist."""
    return make_problem(
        trial.code,
        f"dry run: {trial.motion}",
        trial.message,
        expected="a motion that exists",
        triggered_by=f"skill {session.skill}: its first motion",
        fix="Choose another object, destination or target.",
    )


def _judge(name: str, answer: MotionAnswer | None, ms: float, *, proves: bool = True) -> Trial:
    if answer is None:
        return Trial(motion=name, outcome="undecided", message="the planner did not answer in time", ms=ms)
    if not isinstance(answer, NoPlan):
        return Trial(motion=name, outcome="possible", ms=ms)
    code = PROOFS.get(answer.code, "")
    walls = {each for each in answer.rejected if (met := Contact.parse(each)) and is_wall(met.other)}
    bounds = walls | {"ik", "occupied", "far"} if walls else {"ik"}  # no candidate was rejected for a contact
    if answer.code == "NO_IK" and answer.rejected and set(answer.rejected) <= bounds:
        code = "OUT_OF_REACH"
    if not proves or not code:
        return Trial(motion=name, outcome="undecided", code=answer.code, message=answer.message, ms=ms)
    return Trial(motion=name, outcome="impossible", code=code, message=answer.message, ms=ms)
