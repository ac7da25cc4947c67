"""Requests to the planner process and its answers; poses in the frame `world`, angles in radians.

Budgets are iterations, never seconds: the same request with the same seed gives the same answer, bit for bit.
"""

import msgspec
import numpy as np
from numpy.typing import NDArray

from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.world.environment import Entity, Pose, Region

Array = NDArray[np.float64]


class Neighbour(msgspec.Struct, frozen=True):
    """Another robot; what it holds are the entities that are `held_by` it.

    Attributes:
        postures_rad: (k, n_joints) where it stands, then what is left of the motion that it has announced.
        is_met: Whether the hand comes near it on purpose: only a contact is avoided.
    """

    name: str
    postures_rad: Array
    is_met: bool = False


class World(msgspec.Struct, frozen=True):
    """Believed entities, obstacles included, named regions, and other robots."""

    entities: tuple[Entity, ...]
    regions: tuple[Region, ...] = ()
    neighbours: tuple[Neighbour, ...] = ()


class Load(msgspec.Struct, frozen=True):
    """What a held entity asks of the grip; each value stands at the unfavourable end of its uncertainty.

    `center_m` (3,) is in the tool frame, `gyration_m` about the closing axis, `press_n` of a finger.
    """

    mass_kg: float
    center_m: tuple[float, float, float]
    gyration_m: float
    friction: float
    press_n: float


class Payload(msgspec.Struct, frozen=True):
    """A held entity, by name, and its pose in the hand; `width_m` is the opening of the fingers around it [m]."""

    entity: str
    tcp_T_entity: Pose
    width_m: float = 0.0
    load: Load | None = None


class Approach(msgspec.Struct, frozen=True):
    """A straight tool motion, checked for reach and collision.

    Attributes:
        label: Stable name (`yaw+090`, `site2.yaw+045`), for `avoid` of a later attempt.
        tcp_end: `world_T_tcp` at the end of the line.
        line_rad: (k, n_joints) joint positions from the hover pose (row 0) to the end (row k-1).
        site: Pose of the entity after a place.
        release_m: Opening for which the way back after a place was checked [m].
        fall_m: How far the entity falls when it is let go there [m].
    """

    label: str
    tcp_end: Pose
    line_rad: Array
    site: Pose | None = None
    release_m: float | None = None
    fall_m: float = 0.0


class Trajectory(msgspec.Struct, frozen=True):
    """A timed motion (n, n_joints), sampled at the physics step, from one step after the start to rest."""

    q_rad: Array
    qd_rad_s: Array
    step_s: float

    @property
    def duration_s(self) -> float:
        """Length of the motion [s]."""
        return len(self.q_rad) * self.step_s


class Destination(msgspec.Struct, frozen=True):
    """Where an object is put after it was grasped, and how it is turned; as in `FindPlacements`."""

    name: str
    relation: Meaning = Meaning.INSIDE
    near: tuple[float, float, float] | None = None
    up: tuple[float, float, float] | None = None
    heading_rad: float | None = None
    near_radius_m: float = 0.12


class PlanningState(msgspec.Struct, frozen=True):
    """What a request for a way begins with: the world, the present posture (n_joints,), the seed of all its choices."""

    world: World
    q_rad: Array
    seed: int


GRASPS = 4  # that a skill chooses from


class FindGrasps(PlanningState, frozen=True, tag=True):
    """Grasps of an object. Answer: `Approaches`. Other robots are no obstacles yet: the motion there avoids them.

    Attributes:
        then: Where the object goes; grasps from which it can be put there come first.
        avoid: Labels of unwanted approaches.
        count: Largest number of approaches, nearest first.
        along: (3,) direction in the world along which the fingers close; any if unset.
        removable: Entities that may be moved out of where the object goes; the answer names the fewest that must.
        moves: (4, 4) each, displacements in the world of a handle that is held; grasps that can follow come first.
    """

    object: str
    avoid: tuple[str, ...] = ()
    hover_m: float = 0.08
    count: int = GRASPS
    along: tuple[float, float, float] | None = None
    then: Destination | None = None
    removable: tuple[str, ...] = ()
    moves: tuple[Array, ...] = ()


class FindPlacements(PlanningState, frozen=True, tag=True):
    """Placements of the payload in or on an entity or region, as `FindGrasps`. Answer: `Approaches`.

    Attributes:
        destination: An entity with an interior, an entity to stand on (`relation` ON, not INSIDE), or a region.
        near: (3,) point; sites are at most `near_radius_m` from it.
        up: (3,) direction in the entity's frame that shall point up; as it is held if unset.
        heading_rad: Turn of the entity about the vertical, as `compute_heading` has it; any if unset.
        may_fall: Whether it may be let go above the floor of a container whose walls keep it.
        count: The most that are wanted, the nearest first; where it is one, the first that is found.
        coming: Entities for which room is left where there is enough, if need be where something `removable` is.
    """

    payload: Payload
    destination: str
    relation: Meaning = Meaning.INSIDE
    near: tuple[float, float, float] | None = None
    near_radius_m: float = 0.12
    up: tuple[float, float, float] | None = None
    heading_rad: float | None = None
    avoid: tuple[str, ...] = ()
    hover_m: float = 0.07
    count: int = 4
    may_fall: bool = True
    coming: tuple[str, ...] = ()
    removable: tuple[str, ...] = ()


class FindLine(PlanningState, frozen=True, tag=True):
    """A straight tool motion from here through tool poses, the fingers `width_m` [m] apart; all open if unset.

    Answer: `Approaches` with one approach, or `NoPlan`.
    """

    waypoints: tuple[Pose, ...]
    payload: Payload | None = None
    ignore: tuple[str, ...] = ()
    width_m: float | None = None


class FindPush(PlanningState, frozen=True, tag=True):
    """Straight pushes of an object by the fingers, `width_m` [m] apart, until its origin is at `to_m` (2,).

    Answer: `Approaches`. What is to be ignored moves with it.
    """

    object: str
    to_m: tuple[float, float]
    ignore: tuple[str, ...] = ()
    width_m: float = 0.0
    count: int = 4


class FindTouch(PlanningState, frozen=True, tag=True):
    """Straight ways down of the fingers, `width_m` [m] apart, until their tips are at a point (3,) in the world.

    Answer: `Approaches`. The object that is touched, or pressed, and what moves with it are no obstacles. After
    displacements `moves` (4, 4) those come first whose hand can follow them.
    """

    object: str
    at_m: tuple[float, float, float]
    ignore: tuple[str, ...] = ()
    hover_m: float = 0.06
    width_m: float = 0.0
    count: int = 4
    moves: tuple[Array, ...] = ()


class PlanMove(PlanningState, frozen=True, tag=True):
    """A collision-free timed motion to any of several postures (m, n_joints). Answer: `Motion`.

    Attributes:
        ignore: Entities that are no obstacles.
        speed: Fraction of the velocity limits; acceleration scales with its square.
        width_m: Opening of the fingers on the way, without a payload [m]; as wide as they go if unset.
    """

    goals_rad: Array
    payload: Payload | None = None
    ignore: tuple[str, ...] = ()
    speed: float = 1.0
    width_m: float | None = None


class TimeLine(msgspec.Struct, frozen=True, tag=True):
    """Timing of given joint waypoints (k, n_joints), as of an approach line, for a `load`. Answer: `Motion`."""

    waypoints_rad: Array
    speed: float = 0.25
    load: Load | None = None


class ShapeTransport(msgspec.Struct, frozen=True, tag=True):
    """Timing of joint waypoints so that an open vessel does not spill. Answer: `Motion`.

    Attributes:
        tilt_max_rad: Largest angle between the vessel's axis and the apparent gravity [rad].
        method: `casadi` (shaped) or `toppra` (joint limits only).
    """

    waypoints_rad: Array
    tilt_max_rad: float = 0.08
    method: str = "casadi"
    load: Load | None = None


class CheckPosture(PlanningState, frozen=True, tag=True):
    """Contacts of a posture (n_joints,), of the robot itself and with the world. Answer: `PostureCheck`."""

    ignore: tuple[str, ...] = ()


class Cancel(msgspec.Struct, frozen=True, tag=True):
    """Cancel the running request; its answer becomes `NoPlan` with code CANCELLED."""


class Timing(msgspec.Struct, frozen=True):
    """Wall time of one answer [ms] by stage (`ik`, `path`, `timing`, `check`, `model`)."""

    ms: dict[str, float]


class Screening(msgspec.Struct, frozen=True):
    """Candidates of compiled inverse kinematics: damped least squares to 1e-4 m and 1e-3 rad.

    `solved` start postures were iterated from; `reached` of them reached their tool pose.
    """

    solved: int
    reached: int


class Differential(msgspec.Struct, frozen=True):
    """Inverse kinematics that starts near; errors are the largest of all solved postures.

    `iterations` counts mink's quadratic programs, at least one for each posture.
    """

    iterations: int
    position_error_m: float
    rotation_error_rad: float


class GoalPosture(msgspec.Struct, frozen=True, omit_defaults=True):
    """How one approach was solved: its hover posture, and the postures on its line.

    `hover` is None for a line that begins at the present posture.
    """

    label: str
    line: Differential
    hover: Differential | None = None


class PathSearch(msgspec.Struct, frozen=True):
    """How a path was found.

    Attributes:
        planner: `straight` where the direct joint motion is free, otherwise OMPL's.
        checker: Collision check of the search: `spheres`, `larger spheres`, or `exact` and `exact, fine` for MuJoCo.
        goals: Offered postures; all of them are roots of one search.
        iterations: Of the search that is kept; 0 for `straight`.
        attempts: Searches until a path stayed free once it was timed.
        exact_checks: Postures that MuJoCo checked.
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
        solver: `toppra`, `casadi`, or `quintic` for a motion too small for toppra; `status` is its own word.
        solver_iterations: Of casadi's solver, fatrop.
        worst_tilt_rad: Of a vessel against its apparent gravity; `unshaped_` fields give toppra's alone.
        grip_share: Greatest share of what the grip bears, at the bad ends of its uncertainties.
    """

    solver: str
    status: str
    duration_s: float
    solver_iterations: int | None = None
    worst_tilt_rad: float | None = None
    grip_share: float | None = None
    unshaped_worst_tilt_rad: float | None = None
    unshaped_grip_share: float | None = None
    unshaped_duration_s: float | None = None


class Stages(msgspec.Struct, frozen=True, omit_defaults=True):
    """Which solvers made an answer; a stage that did not run is absent.

    Compiled inverse kinematics screens, mink solves goal postures and lines, OMPL finds the path, toppra or casadi the
    scaling. `calls` are of each library, those for candidates that were rejected too (`calls.Solver`).
    """

    screening: Screening | None = None
    goals: tuple[GoalPosture, ...] = ()
    path: PathSearch | None = None
    scaling: TimeScaling | None = None
    calls: dict[str, int] = {}


class Approaches(msgspec.Struct, frozen=True, tag=True):
    """At least one approach, the nearest first; `gone` has to be moved away for what comes after it.

    `leads_on` is whether a way was found from the first one to where the object goes then.
    """

    approaches: tuple[Approach, ...]
    timing: Timing
    stages: Stages = Stages()
    gone: tuple[str, ...] = ()
    leads_on: bool = False


class Motion(msgspec.Struct, frozen=True, tag=True):
    """One timed motion; `goal` is the index into `goals_rad` that it reaches."""

    trajectory: Trajectory
    goal: int
    timing: Timing
    stages: Stages = Stages()


class PostureCheck(msgspec.Struct, frozen=True, tag=True):
    """Contacts of a posture, as `link5|wall`; empty when it is free.

    `escapes` is whether a short straight way out of all contacts was found.
    """

    contacts: tuple[str, ...]
    escapes: bool
    timing: Timing
    stages: Stages = Stages()


class NoPlan(msgspec.Struct, frozen=True, tag=True):
    """No plan exists, or none was found within the budget.

    `code` is `NO_IK`, `IN_COLLISION`, `NO_PLAN`, `NO_FREE_SITE`, `OBJECT_GONE`, `NOT_GRASPABLE`, `CANCELLED`, ...
    Candidates are counted by the reason of rejection (`ik`, `line`, `link5|wall`); `neighbours` were in the way.
    """

    code: str
    message: str
    timing: Timing
    rejected: dict[str, int] = {}
    stages: Stages = Stages()
    neighbours: tuple[str, ...] = ()


MotionRequest = (
    FindGrasps | FindPlacements | FindLine | FindPush | FindTouch | PlanMove | TimeLine | ShapeTransport | CheckPosture
)
MotionAnswer = Approaches | Motion | PostureCheck | NoPlan
