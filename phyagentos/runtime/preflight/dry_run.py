"""A dry run: whether the first motions of a skill can exist in the world as it stands. Nothing moves.

Upstream: the session, its tree, the observed world. Downstream: `compatibility`. Three answers: possible, impossible,
undecided; only what is proved impossible rejects a session. That a search within its budget found no way is no proof.
"""

from collections.abc import Generator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, Problem
from phyagentos.geometry import compute_inverse, compute_matrix, compute_pose
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.skill_runtimes import Parameter, find_mismatch
from phyagentos.protocol.capabilities.trees import Node, NodeKind, Reference, read_tree
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.sessions.trace import STILL, Role
from phyagentos.protocol.world.environment import Entity, Environment, Shape
from phyagentos.runtime.execution.leaf_registry import LeafRegistry
from phyagentos.runtime.motion.process import Planner
from phyagentos.runtime.motion.requests import (
    Approaches,
    CheckPosture,
    FindGrasps,
    FindPlacements,
    MotionAnswer,
    MotionRequest,
    NoPlan,
    Payload,
    PlanMove,
    Stance,
    TimeLine,
    World,
)
from phyagentos.runtime.preflight.adapter_plan import Trial
from phyagentos.runtime.preflight.findings import make_problem
from phyagentos.runtime.preflight.reach import Reach

CANDIDATES = 1  # one way is enough to know that there is one
ANSWER_S = 60.0  # by the wall clock; at the first session the planner may still be starting
SHARE = 0.5  # of the time that the contract allows the whole examination
PATH_SPEED = 1.0
NUDGE_RAD = 0.01  # the shortest line that there is to time
HAND_M = 0.05  # a tool point that grasps a thing is this near to its solids at most
PROOFS = {  # of the planner's answers: what can never be, and under which code it is told
    "TOO_WIDE": "TOO_WIDE",
    "NO_SPACE": "NO_SPACE",
    "NO_FREE_SITE": "NO_FREE_SITE",
    "UNKNOWN_ENTITY": "ENTITY_UNKNOWN",
}
REACH_REASONS = {"ik"}  # every candidate died of reach alone, none of a contact
_PASSED_OVER = STILL | {Role.MOVE}  # between grasp and place they move nothing but what is held
_POINT = Parameter(type="point")


@dataclass(frozen=True, slots=True)
class Home:
    """The tree goes to the home posture, before anything has moved."""


@dataclass(frozen=True, slots=True)
class Grasp:
    """The tree takes hold of a thing, before anything has moved."""

    object: str


@dataclass(frozen=True, slots=True)
class Place:
    """The tree puts down what it took hold of."""

    destination: str
    relation: str
    near: tuple[float, float, float] | None


Motions = Generator[Home | Grasp | Place, None, bool]


@dataclass(frozen=True, slots=True, kw_only=True)
class DryRun:
    """Asks the planner as the tree will.

    Args:
        planner: The worker's; idle between sessions.
        library: Where trees are.
        registry: Where leaves declare their roles.
        clock: Measures the cost.
        home_rad: Where the arm stands before a session.
        reach: Bound on the tool; None where there is none.
        patience_s: Longest wait for one answer, by the wall clock; then it decides nothing.
    """

    planner: Planner
    library: Library
    registry: LeafRegistry
    clock: Clock
    home_rad: tuple[float, ...]
    reach: Reach | None
    patience_s: float = ANSWER_S

    def run(self, session: Session, tree: str, now: Environment, *, thorough: bool) -> tuple[Trial, ...]:
        """Look at the posture that the arm begins with; try the first grasp and the place that follows it.

        Args:
            session: The contract.
            tree: Its behaviour tree.
            now: The world.
            thorough: Also look for a collision-free path to the grasp; costs more and never rejects.
        """
        trials: list[Trial] = []
        state = now.targets.get(session.target)
        q_rad = np.asarray(state.q_rad if state is not None else self.home_rad, dtype=np.float64)
        world = World(tuple(now.entities.values()), tuple(now.regions.values()))
        grasped: Payload | None = None
        if thorough:
            self._ask(
                TimeLine(waypoints_rad=np.stack((q_rad, q_rad + NUDGE_RAD)))
            )  # it is ready: the costs are its own
        start = self._try_posture(session, "start", world, q_rad)
        if start.outcome != "possible" or thorough:
            trials.append(start)
        for motion in find_motions(tree, session.parameters, self.library, self.registry):
            if isinstance(motion, Home):
                home_rad = np.asarray(self.home_rad, dtype=np.float64)
                if float(np.abs(home_rad - q_rad).max()) > NUDGE_RAD:
                    trials.append(self._try_posture(session, "home", world, home_rad))
                    q_rad = home_rad
            elif isinstance(motion, Grasp):
                entity = now.entities.get(motion.object)
                if entity is None:
                    break  # told by the names
                trial, answer = self._try_grasp(session, motion, entity, world, q_rad)
                trials.append(trial)
                if not isinstance(answer, Approaches):
                    break
                way = answer.approaches[0]
                if thorough:
                    trials.append(self._try_path(session, motion, way.line_rad[:1], world, q_rad))
                inverse = compute_inverse(compute_matrix(way.tcp_end))
                grasped = Payload(motion.object, compute_pose(inverse @ compute_matrix(entity.pose)))
                q_rad = way.line_rad[-1]
            elif grasped is not None:
                trials.append(self._try_place(session, motion, grasped, now, world, q_rad))
        return tuple(trials)

    def _try_posture(self, session: Session, name: str, world: World, q_rad: "np.ndarray") -> Trial:
        """What the arm touches of itself and of what cannot be moved, where it stands or where the tree sends it.

        It can leave a contact at the start if there is a short way out; into one it is never led.
        """
        movable = tuple(each.name for each in world.entities if each.movable)
        answer, ms = self._ask(CheckPosture(world=world, q_rad=q_rad, seed=session.seed, ignore=movable))
        if not isinstance(answer, Stance):
            return _judge(f"{name} posture", answer, ms, proves=False)
        if not answer.contacts:
            return Trial(motion=f"{name} posture", outcome="possible", ms=ms)
        is_proved = name == "home" or not answer.escapes
        message = f"in this posture {', '.join(answer.contacts)} touch" + ("" if is_proved else "; there is a way out")
        outcome: Literal["impossible", "undecided"] = "impossible" if is_proved else "undecided"
        return Trial(motion=f"{name} posture", outcome=outcome, code="IN_COLLISION", message=message, ms=ms)

    def _try_grasp(
        self, session: Session, motion: Grasp, entity: Entity, world: World, q_rad: "np.ndarray"
    ) -> tuple[Trial, MotionAnswer | None]:
        name = f"grasp {motion.object}"
        excess_m = self._compute_excess(entity)
        if excess_m > 0.0:
            message = f"{motion.object} lies {excess_m:.3f} m beyond the longest reach of {session.target}"
            return Trial(motion=name, outcome="impossible", code="OUT_OF_REACH", message=message), None
        avoid = session.strategy.avoid_grasps
        request = FindGrasps(
            world=world, object=motion.object, q_rad=q_rad, seed=session.seed, avoid=avoid, count=CANDIDATES
        )
        answer, ms = self._ask(request)
        return _judge(name, answer, ms), answer

    def _try_place(
        self, session: Session, motion: Place, payload: Payload, now: Environment, world: World, q_rad: "np.ndarray"
    ) -> Trial:
        name = f"place {payload.entity} {motion.relation} {motion.destination}"
        place = now.entities.get(motion.destination) or now.regions.get(motion.destination)
        if place is None:
            return Trial(motion=name, outcome="undecided", message="the destination is not in the world")
        request = FindPlacements(
            world=world,
            payload=payload,
            destination=motion.destination,
            q_rad=q_rad,
            seed=session.seed,
            relation=motion.relation,
            near=motion.near,
            avoid=session.strategy.avoid_sites,
            count=CANDIDATES,
        )
        answer, ms = self._ask(request)
        return _judge(name, answer, ms)

    def _try_path(
        self, session: Session, motion: Grasp, goals_rad: "np.ndarray", world: World, q_rad: "np.ndarray"
    ) -> Trial:
        request = PlanMove(world=world, q_rad=q_rad, goals_rad=goals_rad, seed=session.seed, speed=PATH_SPEED)
        answer, ms = self._ask(request)
        return _judge(f"path to {motion.object}", answer, ms, proves=False)

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
        """How far a thing lies beyond every grasp of it [m]."""
        if self.reach is None:
            return 0.0
        own_m = max((_compute_radius(shape) for shape in entity.shapes), default=0.0)
        return self.reach.compute_excess(entity.pose.position_m) - own_m - HAND_M


def _compute_radius(shape: Shape) -> float:
    """Of a ball about the entity's origin that holds the shape [m]."""
    return float(np.linalg.norm(shape.pose.position_m) + np.linalg.norm(shape.size_m))


def find_motions(
    tree: str, arguments: Mapping[str, Any], library: Library, registry: LeafRegistry, within: tuple[str, ...] = ()
) -> Motions:
    """The grasp that a tree surely begins with, and the place that surely follows it.

    What stands in a fallback, a retry or any other control node is passed over, with everything after it: it may not
    be reached, or not in this world. So is everything after the place, or after a leaf of somebody else.

    Returns:
        Whether the whole tree was looked through, so that what follows it is as sure.
    """
    try:
        authored = read_tree(library.get_tree(tree))
    except DefinitionError:
        return False  # told by the check of trees
    inputs = authored.header.inputs
    known = {name: port.default for name, port in inputs.items() if port.default is not None}
    known |= {name: value for name, value in arguments.items() if value is not None}
    return (yield from _find_in(authored.root, known, library, registry, (*within, tree)))


def _find_in(
    node: Node, known: Mapping[str, Any], library: Library, registry: LeafRegistry, within: tuple[str, ...]
) -> Motions:
    children = node.children if node.kind is NodeKind.SEQUENCE else (node,)
    for child in children:
        wired = {
            port: known.get(value.key) if isinstance(value, Reference) else value
            for port, value in child.wiring.items()
        }
        if child.kind is NodeKind.SUBTREE and child.type not in within:
            if not (yield from find_motions(child.type, wired, library, registry, within)):
                return False
            continue
        leaf = registry.find(child.type) if child.kind is NodeKind.LEAF else None
        role = leaf.ROLE if leaf is not None else None
        if role is Role.HOME:
            yield Home()
        elif role is Role.PLAN_GRASP and isinstance(object := wired.get("object"), str):
            yield Grasp(object)
        elif role is Role.PLAN_SITE and (place := _make_place(wired)) is not None:
            yield place
            return False
        elif role not in _PASSED_OVER:
            return False
    return True


def _make_place(wired: Mapping[str, Any]) -> Place | None:
    destination, near = wired.get("destination"), wired.get("near")
    if not isinstance(destination, str):
        return None
    if near is not None and find_mismatch(_POINT, near):
        return None  # told by the arguments
    point = None if near is None else (float(near[0]), float(near[1]), float(near[2]))
    return Place(destination, str(wired.get("relation") or "inside"), point)


def make_trial_problem(trial: Trial, session: Session) -> Problem:
    """Why a session is rejected whose first motion cannot exist."""
    return make_problem(
        trial.code,
        f"dry run: {trial.motion}",
        trial.message,
        "a motion that exists",
        triggered_by=f"skill {session.skill}: its first motion",
        fix="Choose another thing, destination or target.",
    )


def _judge(name: str, answer: MotionAnswer | None, ms: float, *, proves: bool = True) -> Trial:
    if answer is None:
        return Trial(motion=name, outcome="undecided", message="the planner did not answer in time", ms=ms)
    if not isinstance(answer, NoPlan):
        return Trial(motion=name, outcome="possible", ms=ms)
    code = PROOFS.get(answer.code, "")
    if answer.code == "NO_IK" and answer.rejected and set(answer.rejected) <= REACH_REASONS:
        code = "OUT_OF_REACH"
    if not proves or not code:
        return Trial(motion=name, outcome="undecided", code=answer.code, message=answer.message, ms=ms)
    return Trial(motion=name, outcome="impossible", code=code, message=answer.message, ms=ms)
