"""The world in which motions are checked: the robot, its payload, and the believed entities.

One compiled MuJoCo model serves all worlds whose entities have the same kinds of solids: entities are mocap bodies, and
solids are posed and sized anew, so that no new belief costs a compilation. Contact bits leave out pairs of entities,
and what the robot stands on. Immovable entities are inflated by 4 mm, movable ones by 2 mm, the payload by 2 %.
Base and first link ignore immovable entities, on which the robot stands; wheels or legs of a base that moves ignore the
ground alone. Fingers stand where they are commanded; around a payload they take every opening from that at which they
hold it to that at which they let go. The tool centre point is a ball that meets only its bounds.
"""

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Sequence
from functools import lru_cache
from itertools import pairwise
from math import ceil

import mujoco
import numpy as np

from phyagentos.geometry import compute_matrix, compute_quaternion, compute_rotation, make_matrix
from phyagentos.protocol.world.environment import Entity, ShapeKind
from phyagentos.runtime.models.base import GROUND
from phyagentos.runtime.motion.requests import Array, Payload, World
from phyagentos.runtime.motion.robot_model import ROBOT_BIT, WORLD_BIT, RobotModel
from phyagentos.runtime.motion.solids import Kinds, Shapes, SolidBody, add_solids, measure_solids
from phyagentos.runtime.motion.tool_bounds import BALL_M, is_wall, iter_walls

Pair = tuple[str, str]

PAYLOAD = "payload"
ARM = "arm"  # any part of the robot, and what it holds, beside another robot
FIXED_MARGIN_M = 0.004  # of walls and tables: calibration and tracking error
MOVABLE_MARGIN_M = 0.002  # smaller, since fingers must pass beside a neighbour
PAYLOAD_SCALE = 1.02
ROOM_BIT, BASE_BIT = 4, 8  # of the tool's bounds; of what the robot stands on
PARKED_M = (0.0, 0.0, -10.0)
SWEEP, NEAR_M = 4, 0.013  # openings that stand for a range; fewer that are so near, as thick as a finger
BLOCK = 5  # rows of a motion that one check with a margin can cover
_CACHE_SIZE = 8
_SPREADS = 64  # openings at which the places of the fingers are kept
AROUND = "around/"  # before the name of a body around the robot
_COPY = "/opening"  # in the name of a body that stands for a finger


class PlanningScene:
    """A compiled planning model, posed as one world; exact collision checks.

    Attributes:
        checks: Configurations checked since `pose`, edges in steps of `finest_rad` at most.
        obstacles: Entities of the world that are not parked.
        crowd: Groups of spheres (k, 4) of other robots, by their names.
        crowd_checks: Whether a posture (n_joints,) is clear of each; `crowded_by` are those of which one was not.
    """

    def __init__(self, robot: RobotModel, around: Sequence[Kinds], held: Kinds) -> None:
        self.robot = robot
        self.payload_shapes: Shapes = ()
        self.checks, self.finest_rad = 0, np.inf
        self._model = model = _compile(robot, around, held)
        self._data = mujoco.MjData(model)
        self._qpos = self._data.qpos
        self._bodies = [(kinds, SolidBody(model, f"{AROUND}{index}")) for index, kinds in enumerate(around)]
        self._held = SolidBody(model, PAYLOAD) if held else None
        self._owner = [model.body(int(body)).name.partition(_COPY)[0] for body in range(model.nbody)]
        self._is_obstacle = [is_wall(name) or name.startswith(AROUND) for name in self._owner]  # by body, too
        self._fingers = [  # body, which opening it stands for, its places
            (int(body.id), index, track)
            for name, track in robot.fingers.items()
            for index in range(SWEEP if held else 1)
            for body in (self._model.body(_name_copy(name, index)),)
        ]
        self._moved = np.array([body for body, _, _ in self._fingers], dtype=np.intp)
        self._body_pos, self._body_quat = model.body_pos, model.body_quat  # views, which take a while to make
        self._places: dict[tuple[float, float], tuple[Array, Array]] = {}  # of all fingers, by the openings
        self._spread: tuple[float, float] | None = None  # openings at which the fingers stand
        self.obstacles: list[Entity] = []
        self.crowd: dict[str, list[Array]] = {}
        self.crowd_checks: dict[str, Callable[[Array], bool]] = {}
        self.crowded_by: set[str] = set()
        self.tcp_T_payload = np.eye(4)

    def pose(self, world: World, payload: Payload | None, ignore: Iterable[str] = ()) -> None:
        """Pose this scene as a world with just its kinds of solids; park payload and ignored entities far below."""
        gone = {*ignore, *([payload.entity] if payload else [])}
        self.obstacles = [entity for entity in world.entities if entity.name not in gone]
        free = defaultdict[Kinds, list[SolidBody]](list)
        for kinds, body in self._bodies:
            free[kinds].append(body)
        self._data.mocap_pos[:] = PARKED_M
        for each in (each for each in self.obstacles if each.shapes):
            body = free[tuple(shape.kind for shape in each.shapes)].pop()
            is_base = self.robot.profile.base is None or each.kind == GROUND
            body.fill(
                rows=measure_solids(each.shapes, MOVABLE_MARGIN_M if each.movable else FIXED_MARGIN_M),
                contype=BASE_BIT if is_base and not each.movable else WORLD_BIT,
            )
            self._owner[body.id] = each.name
            place = self._model.body_mocapid[body.id]
            self._data.mocap_pos[place], self._data.mocap_quat[place] = each.pose.position_m, each.pose.quaternion_wxyz
        if payload is not None and self._held is not None:
            self.payload_shapes = next(each.shapes for each in world.entities if each.name == payload.entity)
            self._held.fill(measure_solids(self.payload_shapes, 0.0, PAYLOAD_SCALE), ROBOT_BIT)
            self.tcp_T_payload = compute_matrix(payload.tcp_T_entity)
            site = self._model.site(self.robot.profile.tcp)
            tool_T_payload = make_matrix(compute_rotation(site.quat), site.pos) @ self.tcp_T_payload
            self._model.body_pos[self._held.id] = tool_T_payload[:3, 3]
            self._model.body_quat[self._held.id] = compute_quaternion(tool_T_payload[:3, :3])
        most_m = self.robot.profile.gripper.max_width_m
        self.spread_fingers(most_m if payload is None else payload.width_m, most_m)
        self.checks, self.finest_rad = 0, np.inf
        self.crowd, self.crowd_checks, self.crowded_by = {}, {}, set()

    def sweep(self, q_rad: Array, low_m: float, high_m: float, tolerate: Collection[Pair] = frozenset()) -> list[Pair]:
        """Pairs that touch in a posture (n_joints,), but for those to `tolerate`.

        That is at the widest opening of the fingers, from `high_m` down to `low_m` [m], at which any do.
        """
        stands_for_all = self.payload_shapes or low_m == high_m  # with a payload there are copies of the fingers
        count = min(SWEEP, 1 + ceil((high_m - low_m) / NEAR_M))
        for opening_m in (high_m,) if stands_for_all else _list_openings(low_m, high_m, count):
            self.spread_fingers(low_m if stands_for_all else opening_m, opening_m)
            if pairs := [pair for pair in self.find_contacts(q_rad) if pair not in tolerate]:
                return pairs
        return []

    def spread_fingers(self, low_m: float, high_m: float) -> None:
        """Let the fingers stand at an opening `high_m` [m]; with a payload also at those down to `low_m` [m]."""
        if self._spread == (low_m, high_m):
            return
        self._spread = low_m, high_m
        if self._spread not in self._places:
            openings_m = [high_m] * SWEEP if high_m <= low_m else _list_openings(low_m, high_m, SWEEP)
            placed = [track.place(openings_m[index]) for _, index, track in self._fingers]
            places = np.array([p for p, _ in placed]).reshape(-1, 3), np.array([q for _, q in placed]).reshape(-1, 4)
            if len(self._places) >= _SPREADS:
                del self._places[next(iter(self._places))]
            self._places[self._spread] = places
        self._body_pos[self._moved], self._body_quat[self._moved] = self._places[self._spread]

    def is_free(self, q_rad: Array) -> bool:
        """Whether a posture (n_joints,) touches nothing; exact."""
        self.checks += 1
        self._qpos[:] = q_rad
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_collision(self._model, self._data)
        return self._data.ncon == 0 and not (self.crowd_checks and self._find_crowding(q_rad))

    def _find_crowding(self, q_rad: Array) -> list[str]:
        """Other robots that are too near in a posture (n_joints,)."""
        crowding = [name for name, is_clear in self.crowd_checks.items() if not is_clear(q_rad)]
        self.crowded_by.update(crowding)
        return crowding

    def find_contacts(self, q_rad: Array, depth_m: float = 0.0) -> list[Pair]:
        """Pairs that touch in a posture (n_joints,), sorted and unique; robot bodies come first.

        Pairs that penetrate by no more than `depth_m` [m] are left out.
        """
        if self.is_free(q_rad):
            return []
        pairs = set()
        contacts = self._data.contact
        bodies = self._model.geom_bodyid[contacts.geom]
        for (first, second), away_m in zip(bodies.tolist(), contacts.dist.tolist(), strict=True):
            if away_m < -depth_m:
                a, b = self._owner[first], self._owner[second]
                pairs.add((b, a) if self._is_obstacle[first] else (a, b))
        pairs.update((ARM, name) for name in self._find_crowding(q_rad))
        return sorted(pairs)

    def is_of_tool_pose(self, pair: Pair) -> bool:
        """Whether a contact follows from the tool's pose alone, whatever the arm's posture."""
        return (pair[0] == PAYLOAD or pair[0] in self.robot.hand) and pair[1] not in self.robot.bodies

    def edge_is_free(self, start_rad: Array, end_rad: Array, resolution_rad: float = 0.03) -> bool:
        """Whether the straight joint motion after `start_rad` is free, at the given resolution; coarse to fine."""
        delta = end_rad - start_rad
        steps = max(1, int(np.ceil(np.linalg.norm(delta) / min(resolution_rad, self.finest_rad))))
        return all(self.is_free(start_rad + delta * (k / steps)) for k in _coarse_to_fine(steps))

    def path_is_free(self, path_rad: Array, resolution_rad: float = 0.05) -> bool:
        """Whether every edge of a path (k, n_joints) is free."""
        return all(self.edge_is_free(a, b, resolution_rad) for a, b in pairwise(path_rad))

    def find_first_blocked(self, rows_rad: Array, apart_m: float = np.inf) -> tuple[int, list[Pair]] | None:
        """Index and contacts of the first row (k, n_joints) that is not free.

        `apart_m` [m] bounds how far any point of the robot moves from a row to the next: rows are passed over where
        nothing is as near as they could reach from the middle one.
        """
        for begin in range(0, len(rows_rad), BLOCK):
            rows = rows_rad[begin : begin + BLOCK]
            if not self._is_clear(rows[len(rows) // 2], len(rows) * apart_m):
                for index, q in enumerate(rows, begin):
                    if contacts := self.find_contacts(q):
                        return index, contacts
        return None

    def _is_clear(self, q_rad: Array, margin_m: float) -> bool:
        """Whether no two solids of the model are nearer than this in a posture (n_joints,)."""
        if np.isinf(margin_m) or self.crowd_checks:
            return False
        options = self._model.opt
        options.o_margin, options.enableflags = margin_m, options.enableflags | mujoco.mjtEnableBit.mjENBL_OVERRIDE
        try:
            return self.is_free(q_rad)
        finally:
            options.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_OVERRIDE)


class PlanningScenes:
    """The scenes of one robot, compiled when a world with other kinds of solids is met."""

    def __init__(self, robot: RobotModel) -> None:
        self._robot = robot
        self._scenes: dict[tuple[tuple[Kinds, ...], Kinds], PlanningScene] = {}

    def get_scene(self, world: World, payload: Payload | None = None, ignore: Iterable[str] = ()) -> PlanningScene:
        """The scene with such solids, posed as this world."""
        solid = {each.name: tuple(shape.kind for shape in each.shapes) for each in world.entities if each.shapes}
        held = () if payload is None else solid.get(payload.entity, ())
        key = tuple(sorted(solid.values())), held
        scene = self._scenes.pop(key, None) or PlanningScene(self._robot, *key)
        self._scenes[key] = scene
        if len(self._scenes) > _CACHE_SIZE:
            del self._scenes[next(iter(self._scenes))]
        scene.pose(world, payload if held else None, ignore)
        return scene


@lru_cache(maxsize=256)
def _list_openings(low_m: float, high_m: float, count: int) -> list[float]:
    """Those that stand for a range, the widest first [m]."""
    return np.linspace(high_m, low_m, count).tolist()  # type: ignore[no-any-return]


def _compile(robot: RobotModel, around: Sequence[Kinds], held: Kinds) -> mujoco.MjModel:
    spec = robot.spec.copy()
    for geom in spec.geoms:
        if geom.parent.name not in robot.mounting:
            geom.conaffinity |= BASE_BIT
    for index, kinds in enumerate(around):
        add_solids(spec.worldbody.add_body(name=f"{AROUND}{index}", mocap=True), kinds, WORLD_BIT, 0)
    if held:
        add_solids(spec.body(robot.tool).add_body(name=PAYLOAD), held, ROBOT_BIT, ROBOT_BIT | WORLD_BIT | BASE_BIT)
        _copy_fingers(spec, robot)
    # a ball far below: MuJoCo sorts bodies along the axis of their greatest spread, and the vertical halves a check
    add_solids(spec.worldbody.add_body(mocap=True, pos=PARKED_M), (ShapeKind.SPHERE,), WORLD_BIT, 0)
    _add_tool_bounds(spec, robot)
    return spec.compile()


def _add_tool_bounds(spec: mujoco.MjSpec, robot: RobotModel) -> None:
    """The walls that bound the tool, and the ball that meets nothing else."""
    bits = {"condim": 1, "mass": 0.001, "contype": ROOM_BIT, "conaffinity": ROOM_BIT}
    for name, center_m, half_m in iter_walls(robot.bounds):
        wall = spec.body(name) or spec.worldbody.add_body(name=name)
        wall.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=half_m, pos=center_m, **bits)
    site = spec.site(robot.profile.tcp)
    site.parent.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(BALL_M, 0.0, 0.0), pos=site.pos, **bits)


def _copy_fingers(spec: mujoco.MjSpec, robot: RobotModel) -> None:
    """Bodies with the solids of the fingers, which stand for their other openings."""
    for finger in map(spec.body, robot.fingers):
        for index in range(1, SWEEP):
            body = finger.parent.add_body(name=_name_copy(finger.name, index), pos=finger.pos, quat=finger.quat)
            for geom in finger.geoms:
                same = {key: getattr(geom, key) for key in ("type", "size", "pos", "quat", "meshname")}
                body.add_geom(**same, contype=geom.contype, conaffinity=geom.conaffinity, condim=1, mass=0.001)
            for pair in list(spec.excludes):
                if finger.name in (names := (pair.bodyname1, pair.bodyname2)):
                    other = names[names[0] == finger.name]
                    spec.add_exclude(name=f"{body.name}|{other}", bodyname1=body.name, bodyname2=other)


def _name_copy(finger: str, index: int) -> str:
    return f"{finger}{_COPY}{index}" if index else finger


def _coarse_to_fine(steps: int) -> Iterable[int]:
    """Indices 1..steps: the end first, then halves, quarters, and so on."""
    yield steps
    stride = 1 << max(0, (steps - 1).bit_length())
    while stride >= 2:
        yield from range(stride // 2, steps, stride)
        stride //= 2
