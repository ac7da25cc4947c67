"""What a worker asks of its planner process, and what it gets. All poses in the frame `world`, all angles in radians.

Budgets are iterations, never seconds: the same request with the same seed gives the same answer, bit for bit.
"""

import msgspec
import numpy as np
from numpy.typing import NDArray

from phyagentos.protocol.world.environment import Entity, Pose, Region

Array = NDArray[np.float64]


class World(msgspec.Struct, frozen=True):
    """What the planner must know of the world: believed entities (obstacles included) and named regions."""

    entities: tuple[Entity, ...]
    regions: tuple[Region, ...] = ()


class Payload(msgspec.Struct, frozen=True):
    """A held thing.

    Attributes:
        entity: Its name.
        tcp_T_entity: Where it sits in the hand.
    """

    entity: str
    tcp_T_entity: Pose


class Approach(msgspec.Struct, frozen=True):
    """A straight way of the tool to a place, checked for reach and collision.

    Attributes:
        label: Stable name of this way (`yaw+090`, `site2.yaw+045`), for `avoid` of a later attempt.
        tcp_end: `world_T_tcp` at the end of the line.
        line_rad: (k, n_joints) joint positions from the hover pose (row 0) to the end (row k-1).
        site: Where the entity will stand after a place, else None.
    """

    label: str
    tcp_end: Pose
    line_rad: Array
    site: Pose | None = None


class Trajectory(msgspec.Struct, frozen=True):
    """A timed motion, sampled at the physics step.

    Attributes:
        q_rad: (n, n_joints) positions; row 0 is one step after the start.
        qd_rad_s: (n, n_joints) velocities; the last row is zero.
        step_s: Sampling period [s].
    """

    q_rad: Array
    qd_rad_s: Array
    step_s: float

    @property
    def duration_s(self) -> float:
        """Length of the motion [s]."""
        return len(self.q_rad) * self.step_s


class FindGrasps(msgspec.Struct, frozen=True, tag=True):
    """Ways to take hold of an object from above. Answer: `Approaches`.

    Attributes:
        q_rad: (n_joints,) where the arm is now.
        avoid: Labels of approaches that are not wanted.
        hover_m: Length of the straight approach [m].
        count: How many to return at most, nearest first.
    """

    world: World
    object: str
    q_rad: Array
    seed: int
    avoid: tuple[str, ...] = ()
    hover_m: float = 0.08
    count: int = 4


class FindPlacements(msgspec.Struct, frozen=True, tag=True):
    """Ways to put the payload into or onto something. Answer: `Approaches`.

    Attributes:
        destination: An entity with an interior, an entity to stand on (`relation` "on"), or a region.
        relation: `inside` or `on`.
        near: (3,) point that the site should be close to, else None.
        near_radius_m: How close.
    """

    world: World
    payload: Payload
    destination: str
    q_rad: Array
    seed: int
    relation: str = "inside"
    near: tuple[float, float, float] | None = None
    near_radius_m: float = 0.12
    avoid: tuple[str, ...] = ()
    hover_m: float = 0.07
    count: int = 4


class FindLine(msgspec.Struct, frozen=True, tag=True):
    """A straight tool motion from here through tool poses. Answer: `Approaches` with one approach, or `NoPlan`."""

    world: World
    q_rad: Array
    waypoints: tuple[Pose, ...]
    seed: int
    payload: Payload | None = None
    ignore: tuple[str, ...] = ()


class PlanMove(msgspec.Struct, frozen=True, tag=True):
    """A collision-free timed motion to any of several postures. Answer: `Motion`.

    Attributes:
        goals_rad: (m, n_joints) acceptable end postures.
        ignore: Entities that do not count as obstacles.
        speed: Fraction of the velocity limits; acceleration scales with its square.
    """

    world: World
    q_rad: Array
    goals_rad: Array
    seed: int
    payload: Payload | None = None
    ignore: tuple[str, ...] = ()
    speed: float = 1.0


class TimeLine(msgspec.Struct, frozen=True, tag=True):
    """Timing of given joint waypoints (an approach line). Answer: `Motion`.

    Attributes:
        waypoints_rad: (k, n_joints).
    """

    waypoints_rad: Array
    speed: float = 0.25


class ShapeTransport(msgspec.Struct, frozen=True, tag=True):
    """Timing of joint waypoints so that an open vessel does not spill. Answer: `Motion`.

    Attributes:
        tilt_max_rad: Largest angle between the vessel's axis and the apparent gravity [rad].
        method: `casadi` (shaped) or `toppra` (joint limits only), to compare.
    """

    waypoints_rad: Array
    tilt_max_rad: float = 0.08
    method: str = "casadi"


class CheckPosture(msgspec.Struct, frozen=True, tag=True):
    """What a posture touches, of the robot itself and of the world. Answer: `Stance`.

    Attributes:
        q_rad: (n_joints,).
        ignore: Entities that do not count as obstacles.
    """

    world: World
    q_rad: Array
    seed: int
    ignore: tuple[str, ...] = ()


class Cancel(msgspec.Struct, frozen=True, tag=True):
    """Stop the running request; its answer becomes `NoPlan` with code CANCELLED."""


class Timing(msgspec.Struct, frozen=True):
    """Where the time of one answer went, wall [ms] by stage (`ik`, `path`, `timing`, `check`, `model`)."""

    ms: dict[str, float]


class Screening(msgspec.Struct, frozen=True):
    """Candidates of compiled inverse kinematics: damped least squares to 1e-4 m and 1e-3 rad.

    Attributes:
        solved: Start postures that were iterated from.
        reached: Those that reached their tool pose.
    """

    solved: int
    reached: int


class Differential(msgspec.Struct, frozen=True):
    """Inverse kinematics by mink.

    Attributes:
        iterations: Quadratic programs that were solved; 0 where the start was within tolerance.
        position_error_m: Of the tool afterwards; the largest, where several postures were solved.
        rotation_error_rad: Likewise.
    """

    iterations: int
    position_error_m: float
    rotation_error_rad: float


class GoalPosture(msgspec.Struct, frozen=True, omit_defaults=True):
    """How one approach was solved.

    Attributes:
        label: Of the approach.
        line: Postures on its straight line.
        hover: Polish of the screened posture that the line begins at; None for a line that begins where the arm is.
    """

    label: str
    line: Differential
    hover: Differential | None = None


class PathSearch(msgspec.Struct, frozen=True):
    """How a path was found.

    Attributes:
        planner: `straight` where the direct joint motion is free, otherwise the name of OMPL's planner.
        checker: What called postures free during the search: `spheres`, or `exact` for MuJoCo.
        goals: Postures that were offered; all of them are roots of one search.
        iterations: Polls of the planner's termination condition; 0 for `straight`.
        attempts: Searches until a path stayed free once it was timed.
        exact_checks: Postures that MuJoCo checked.
        length_rad: Of the path.
    """

    planner: str
    checker: str
    goals: int
    iterations: int
    attempts: int
    exact_checks: int
    length_rad: float


class TimeScaling(msgspec.Struct, frozen=True, omit_defaults=True):
    """How a path became a timed motion.

    Attributes:
        solver: `toppra`, `casadi`, or `quintic` for a motion too small for toppra.
        status: The solver's own word.
        duration_s: Of the motion.
        solver_iterations: Of casadi's solver, ipopt.
        worst_tilt_rad: Of a vessel against its apparent gravity, where that was asked for.
        unshaped_worst_tilt_rad: The same with toppra alone.
        unshaped_duration_s: Of the motion with toppra alone.
    """

    solver: str
    status: str
    duration_s: float
    solver_iterations: int | None = None
    worst_tilt_rad: float | None = None
    unshaped_worst_tilt_rad: float | None = None
    unshaped_duration_s: float | None = None


class Stages(msgspec.Struct, frozen=True, omit_defaults=True):
    """Which solvers made an answer; a stage that did not run is absent.

    Attributes:
        screening: Compiled inverse kinematics (`chain`).
        goals: mink, for each approach that was found (`kinematics`).
        path: OMPL, or the direct way (`path`).
        scaling: toppra or casadi (`timing`, `trajectory`).
    """

    screening: Screening | None = None
    goals: tuple[GoalPosture, ...] = ()
    path: PathSearch | None = None
    scaling: TimeScaling | None = None


class Approaches(msgspec.Struct, frozen=True, tag=True):
    """At least one approach, the nearest first."""

    approaches: tuple[Approach, ...]
    timing: Timing
    stages: Stages = Stages()


class Motion(msgspec.Struct, frozen=True, tag=True):
    """One timed motion.

    Attributes:
        goal: Index into `goals_rad` that it reaches.
    """

    trajectory: Trajectory
    goal: int
    timing: Timing
    stages: Stages = Stages()


class Stance(msgspec.Struct, frozen=True, tag=True):
    """How a posture stands.

    Attributes:
        contacts: `link5|wall` for each pair that touches; empty when it is free.
        escapes: Whether a short straight way out of all contacts was found.
    """

    contacts: tuple[str, ...]
    escapes: bool
    timing: Timing
    stages: Stages = Stages()


class NoPlan(msgspec.Struct, frozen=True, tag=True):
    """There is none, or it was not found within the budget.

    Attributes:
        code: `NO_IK`, `IN_COLLISION`, `NO_PATH_FOUND`, `NO_FREE_SITE`, `UNKNOWN_ENTITY`, `TOO_WIDE`, `CANCELLED`, ...
        message: One sentence for people.
        rejected: Why candidates died, counted by reason (`ik`, `line`, `link5|wall`).
    """

    code: str
    message: str
    timing: Timing
    rejected: dict[str, int] = {}
    stages: Stages = Stages()


MotionRequest = FindGrasps | FindPlacements | FindLine | PlanMove | TimeLine | ShapeTransport | CheckPosture
MotionAnswer = Approaches | Motion | Stance | NoPlan
