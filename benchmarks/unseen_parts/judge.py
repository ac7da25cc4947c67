"""Whether predicates are true, from a recorded simulator state and the generator's own room: numpy and MuJoCo alone.

Every answer is a number in units of its own tolerance: 1 and more is true, -1 and less is false, between them two
honest judges may differ (1 mm, 1 degree). `and` takes the least, `or` the greatest. What stands *on* something is borne
by it: told by contact forces. What is *inside*, *on* or *at* a place has been let go of, and rests.
"""

import ast
import operator
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import yaml
from numpy.typing import NDArray

from benchmarks.unseen_parts.rooms import Room

Array = NDArray[np.float64]

UNIT_M, UNIT_RAD = 0.001, np.radians(1.0)
SURE = 99.0
RIM_M, FLOOR_M = 0.003, 0.010  # as the predicates are documented
MOVED_M, MOVED_RAD = 0.015, np.radians(10)
UPRIGHT_RAD, FALLEN_RAD = 0.26, 0.79
REST_M_S = 0.03  # faster things do not rest
TOUCH_N = 0.05
FINGERS = ("left_finger", "right_finger")
GEOM = mujoco.mjtGeom
_RELATIONS = {ast.LtE: operator.le, ast.Lt: operator.lt, ast.GtE: operator.ge, ast.Gt: operator.gt, ast.Eq: operator.eq}
SENSORS = Path(__file__).resolve().parents[2] / "protocol" / "sensors.yaml"


@dataclass(frozen=True, slots=True)
class Pose:
    """Where a body is: (3, 3) and (3,)."""

    turn: Array
    at_m: Array


class Judge:
    """Looks at one recorded moment of one room.

    Args:
        room: Gives interiors and regions; all else is measured.
        model: Of the bundle's `scene.mjb`.
        now: State vector (mjSTATE_INTEGRATION) that is judged.
        before: That from which `moved` counts.
        broken: Names of cameras that something is wrong with; `*` means all.
    """

    def __init__(
        self, room: Room, model: mujoco.MjModel, now: Array, before: Array, broken: frozenset[str] = frozenset()
    ) -> None:
        self._room, self._model, self._broken = room, model, broken
        self._now, self._before = mujoco.MjData(model), mujoco.MjData(model)
        for data, state in ((self._now, now), (self._before, before)):
            mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
            mujoco.mj_forward(model, data)
        self._movable = sorted(name for name in self._iter_free() if name)

    def judge(self, text: str) -> float:
        """One predicate; raises ValueError for what this judge cannot read."""
        formula = ast.parse(text.replace("*", "_each_"), mode="eval").body
        if not _has_each(formula):
            return float(self._judge(formula, ""))
        return float(min((self._judge(formula, name) for name in self._iter_range(formula)), default=0.0))

    def _judge(self, formula: ast.expr, each: str) -> float:
        match formula:
            case ast.BoolOp(ast.And(), parts):
                return min(self._judge(part, each) for part in parts)
            case ast.BoolOp(ast.Or(), parts):
                return max(self._judge(part, each) for part in parts)
            case ast.UnaryOp(ast.Not(), part):
                return -self._judge(part, each)
            case ast.Compare(ast.Call(ast.Name("count"), [body]), [relation], [bound]):
                return self._count(body, relation, ast.literal_eval(bound))
            case ast.Compare(ast.Call(ast.Name(name), terms), [relation], [bound]) if hasattr(self, f"_measure_{name}"):
                value, unit = getattr(self, f"_measure_{name}")(*self._read(terms, each))
                return _compare(value, relation, float(ast.literal_eval(bound)), unit)
            case ast.Call(ast.Name(name), terms) if hasattr(self, f"_is_{name}"):
                return float(getattr(self, f"_is_{name}")(*self._read(terms, each)))
        raise ValueError(f"this judge cannot read {ast.unparse(formula)!r}")

    def _read(self, terms: list[ast.expr], each: str) -> list[str | float | Array]:
        return [
            (each if term.id == "_each_" else term.id)
            if isinstance(term, ast.Name)
            else np.array(ast.literal_eval(term))
            for term in terms
        ]

    def _iter_range(self, formula: ast.AST) -> list[str]:
        named = {node.id for node in ast.walk(formula) if isinstance(node, ast.Name)}
        return [name for name in self._movable if name not in named]

    def _count(self, body: ast.expr, relation: ast.cmpop, bound: float) -> float:
        values = [self._judge(body, name) for name in self._iter_range(body)]
        sure, open_ = sum(v >= 1 for v in values), sum(abs(v) < 1 for v in values)
        answers = {_RELATIONS[type(relation)](n, bound) for n in range(sure, sure + open_ + 1)}
        return 0.0 if len(answers) == 2 else SURE if answers.pop() else -SURE

    # -- statements ----------------------------------------------------------------------------------------------------

    def _is_inside(self, thing: str, place: str) -> float:
        pose, (center, half) = self._frame_of(place), self._box_of(place)
        if not half.any():
            return -SURE
        middle = pose.turn.T @ (self._middle(thing) - pose.at_m) - center
        up = pose.turn[:, 2]
        low = -self._reach(thing, -up) - float(up @ pose.at_m) - center[2]
        slack = (*(half[:2] - abs(middle[:2])), half[2] - RIM_M - low, low + half[2] + FLOOR_M)
        return float(min(*(each / UNIT_M for each in slack), self._rests(thing)))

    def _is_on(self, thing: str, support: str) -> float:
        weight = float(self._model.body_mass[self._id(thing)]) * 9.81
        borne = (self._lift(thing, support) / weight - 0.5) / 0.125
        return min(max(borne, -SURE), self._rests(thing))

    def _is_at(self, thing: str, place: str | Array, tol_m: float = 0.03) -> float:
        return min((float(tol_m) - self._distance(thing, place)) / UNIT_M, self._rests(thing))

    def _is_near(self, thing: str, other: str, tol_m: float = 0.10) -> float:
        values = [(float(tol_m) - far) / UNIT_M for far in self._list_distances(thing, other)]
        return _agree(values)

    def _is_upright(self, thing: str) -> float:
        return _agree([float((UPRIGHT_RAD - tilt) / UNIT_RAD) for tilt in self._list_tilts(thing)])

    def _is_fallen(self, thing: str) -> float:
        return _agree([float((tilt - FALLEN_RAD) / UNIT_RAD) for tilt in self._list_tilts(thing)])

    def _is_moved(self, thing: str) -> float:
        now, then = self._pose(thing), self._pose(thing, self._before)
        way = float(np.linalg.norm(now.at_m - then.at_m))
        turns = (_measure_turn(now.turn.T @ then.turn), self._measure_shown_turn(thing))
        return _agree([float(max((way - MOVED_M) / UNIT_M, (turn - MOVED_RAD) / UNIT_RAD)) for turn in turns])

    def _is_holding(self, _target: str, thing: str) -> float:
        return SURE if self._is_held(thing) else -SURE

    def _is_exists(self, thing: str) -> float:
        return SURE if mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_BODY, thing) >= 0 else -SURE

    def _is_visible(self, thing: str) -> float:
        """Seen by a sound camera now; what a broken one has in view, or any had when the session began, is open."""
        cameras = self._read_cameras()
        sound = [camera for name, camera in cameras.items() if not self._broken & {name, "*"}]
        if max((self._see(thing, camera, self._now) for camera in sound), default=0.0) >= 0.15:
            return SURE
        moments = (self._now, self._before)
        return 0.0 if any(self._see(thing, each, data) for each in cameras.values() for data in moments) else -SURE

    # -- numbers -------------------------------------------------------------------------------------------------------

    def _measure_tilt(self, thing: str) -> tuple[float, float]:
        own, least = self._list_tilts(thing)
        return (own + least) / 2, UNIT_RAD + (own - least) / 2

    def _measure_height(self, thing: str) -> tuple[float, float]:
        return -self._reach(thing, np.array([0.0, 0.0, -1.0])), UNIT_M

    def _measure_distance(self, thing: str, other: str) -> tuple[float, float]:
        found = self._list_distances(thing, other)
        return sum(found) / len(found), UNIT_M + (max(found) - min(found)) / 2

    def _measure_speed(self, thing: str) -> tuple[float, float]:
        return self._speed(thing), 0.005

    # -- geometry ------------------------------------------------------------------------------------------------------

    def _id(self, name: str) -> int:
        found = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_BODY, name)
        if found < 0:
            raise ValueError(f"the recorded world has no {name!r}")
        return int(found)

    def _iter_free(self) -> Iterator[str]:
        for body in range(self._model.nbody):
            joint = self._model.body_jntadr[body]
            if joint >= 0 and self._model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
                yield self._model.body(body).name

    def _pose(self, name: str, data: mujoco.MjData | None = None) -> Pose:
        seen = (data or self._now).body(self._id(name))
        return Pose(seen.xmat.reshape(3, 3).copy(), seen.xpos.copy())

    def _frame_of(self, place: str) -> Pose:
        return Pose(np.eye(3), np.zeros(3)) if place in self._room.spots else self._pose(place)

    def _box_of(self, place: str) -> tuple[Array, Array]:
        """Centre and half extents of a region or an interior, in its frame; no extents without one."""
        if spot := self._room.spots.get(place):
            return np.array(spot.center_m), np.array(spot.half_m)
        thing = self._room.things.get(place)
        if thing is None or thing.form.interior is None:
            return np.zeros(3), np.zeros(3)
        center, half = thing.form.interior
        return np.array(center), np.array(half)

    def _solids(self, name: str) -> list[int]:
        geoms = np.flatnonzero(self._model.geom_bodyid == self._id(name))
        return [int(g) for g in geoms if self._model.geom_contype[g] or self._model.geom_conaffinity[g]]

    def _half(self, geom: int) -> Array:
        """(3,) half extents of the box around a solid, in its own frame."""
        a, b, c = self._model.geom_size[geom]
        kind = self._model.geom_type[geom]
        halves = {GEOM.mjGEOM_BOX: (a, b, c), GEOM.mjGEOM_SPHERE: (a, a, a), GEOM.mjGEOM_CAPSULE: (a, a, a + b)}
        return np.array(halves.get(GEOM(kind), (a, a, b)))

    def _middle(self, name: str) -> Array:
        """(3,) middle of the box around a body, taken in its own frame."""
        pose, ends = self._pose(name), []
        for geom in self._solids(name):
            turn = pose.turn.T @ self._now.geom_xmat[geom].reshape(3, 3)
            at = pose.turn.T @ (self._now.geom_xpos[geom] - pose.at_m)
            reach = self._supports(geom, turn.T)
            ends += [at + reach, at - reach]
        return np.asarray(pose.turn @ ((np.max(ends, axis=0) + np.min(ends, axis=0)) / 2) + pose.at_m)

    def _supports(self, geom: int, directions: Array) -> Array:
        """(n,) how far a solid reaches from its middle along the columns of (3, n) directions of its own frame."""
        a, b, _ = self._model.geom_size[geom]
        flat, axial = np.hypot(directions[0], directions[1]), abs(directions[2])
        match GEOM(self._model.geom_type[geom]):
            case GEOM.mjGEOM_BOX:
                return np.asarray(abs(directions).T @ self._half(geom))
            case GEOM.mjGEOM_SPHERE:
                return np.full(directions.shape[1], a)
            case GEOM.mjGEOM_CAPSULE:
                return np.asarray(a + axial * b)
        return np.asarray(flat * a + axial * b)

    def _reach(self, name: str, direction: Array) -> float:
        """Greatest coordinate of a body along a direction of the world."""
        found = []
        for geom in self._solids(name):
            own = self._now.geom_xmat[geom].reshape(3, 3).T @ direction
            found.append(float(direction @ self._now.geom_xpos[geom] + self._supports(geom, own[:, None])[0]))
        return max(found)

    def _list_tilts(self, name: str) -> tuple[float, float]:
        """Angle of its z axis to the vertical, and the least of all axes that look as this one does [rad]."""
        pose, solids = self._pose(name), self._solids(name)
        own = float(np.arccos(np.clip(pose.turn[2, 2], -1, 1)))
        if len(solids) > 1:
            return own, own
        axes, half = self._now.geom_xmat[solids[0]].reshape(3, 3), self._half(solids[0])
        along = int(np.argmax(abs(axes.T @ pose.turn[:, 2])))  # the axis of the solid that is the body's z
        alike = abs(half - half[along]) < UNIT_M
        is_round = self._model.geom_type[solids[0]] != GEOM.mjGEOM_BOX
        rise = float(np.linalg.norm(axes[2, alike]) if is_round else abs(axes[2, alike]).max())
        return own, min(own, float(np.arccos(min(1.0, rise))))

    def _measure_shown_turn(self, name: str) -> float:
        """How far it has turned since the beginning, but for turns of a round solid about its axis [rad]."""
        now, then, solids = self._pose(name), self._pose(name, self._before), self._solids(name)
        kind = GEOM(self._model.geom_type[solids[0]])
        if len(solids) > 1 or kind == GEOM.mjGEOM_BOX:
            return _measure_turn(now.turn.T @ then.turn)
        axes = [data.geom_xmat[solids[0]].reshape(3, 3)[:, 2] for data in (self._now, self._before)]
        return 0.0 if kind == GEOM.mjGEOM_SPHERE else float(np.arccos(min(1.0, abs(axes[0] @ axes[1]))))

    def _distance(self, thing: str, place: str | Array) -> float:
        """From the middle of a thing to a point, or to the box of a place."""
        if not isinstance(place, str):
            return float(np.linalg.norm(self._middle(thing) - place))
        pose, (center, half) = self._frame_of(place), self._box_of(place)
        if not half.any():
            return float(np.linalg.norm(self._middle(thing) - self._middle(place)))
        local = pose.turn.T @ (self._middle(thing) - pose.at_m) - center
        return float(np.linalg.norm(np.maximum(abs(local) - half, 0.0)))

    def _list_distances(self, thing: str, other: str) -> list[float]:
        """Between middles; what has an interior has two middles."""
        points = [self._middle(other)] if other not in self._room.spots else []
        center, half = self._box_of(other)
        if half.any():
            pose = self._frame_of(other)
            points.append(pose.turn @ center + pose.at_m)
        return [float(np.linalg.norm(self._middle(thing) - point)) for point in points]

    # -- forces and motion ---------------------------------------------------------------------------------------------

    def _speed(self, name: str) -> float:
        joint = int(self._model.body_jntadr[self._id(name)])
        if joint < 0:
            return 0.0
        first = self._model.jnt_dofadr[joint]
        return float(np.linalg.norm(self._now.qvel[first : first + 3]))

    def _rests(self, name: str) -> float:
        """Let go of, and not moving."""
        return -SURE if self._is_held(name) else (REST_M_S - self._speed(name)) / 0.01

    def _is_held(self, name: str) -> bool:
        return all(np.linalg.norm(self._force(name, finger)) > TOUCH_N for finger in FINGERS)

    def _lift(self, name: str, support: str) -> float:
        """Upward force [N] of one body on another."""
        return float(self._force(name, support)[2])

    def _force(self, name: str, other: str) -> Array:
        """(3,) sum of the forces [N] with which another body acts on this one."""
        ours, theirs, total = self._id(name), self._id(other), np.zeros(3)
        wrench = np.zeros(6)
        for index in range(self._now.ncon):
            contact = self._now.contact[index]
            bodies = [int(self._model.geom_bodyid[geom]) for geom in contact.geom]
            if sorted(bodies) == sorted((ours, theirs)):
                mujoco.mj_contactForce(self._model, self._now, index, wrench)
                along = contact.frame.reshape(3, 3).T @ wrench[:3]
                total += along if bodies[1] == ours else -along
        return total

    # -- sight ---------------------------------------------------------------------------------------------------------

    def _read_cameras(self) -> dict[str, dict[str, object]]:
        sensors = yaml.safe_load(SENSORS.read_text())["sensors"]
        rgbd = {name: sensor["camera"] for name, sensor in sensors.items() if sensor["modality"] == "rgbd"}
        return {name: camera for name, camera in rgbd.items() if "scene_camera" not in camera}  # rooms have none

    def _see(self, thing: str, camera: dict[str, object], data: mujoco.MjData) -> float:
        """Share of points of a thing that a camera has in its picture with nothing before them."""
        start, look, up = (np.array(camera.get(key, (0.0, 0.0, 1.0))) for key in ("position_m", "target_m", "up"))
        if "mount" in camera:
            hand = self._pose(str(camera["mount"]), data)
            start, look, up = hand.turn @ start + hand.at_m, hand.turn @ look + hand.at_m, hand.turn @ up
        axis = (look - start) / np.linalg.norm(look - start)
        aside = np.cross(axis, up) / np.linalg.norm(np.cross(axis, up))
        width, height, fovy = (float(str(camera[key])) for key in ("width", "height", "fovy_deg"))
        high = np.tan(np.radians(fovy) / 2)
        wide = high * width / height
        points = list(self._iter_points(thing, data))
        seen = 0
        for point in points:
            ray, geom = point - start, np.zeros(1, dtype=np.int32)
            depth = float(axis @ ray)
            if abs(aside @ ray) > wide * depth or abs(np.cross(aside, axis) @ ray) > high * depth:
                continue
            mujoco.mj_ray(self._model, data, start, ray, None, 1, -1, geom)
            seen += bool(geom[0] >= 0 and self._model.geom_bodyid[geom[0]] == self._id(thing))
        return seen / len(points)

    def _iter_points(self, thing: str, data: mujoco.MjData) -> Iterator[Array]:
        grid = np.array([[x, y, z] for x in (-0.9, 0, 0.9) for y in (-0.9, 0, 0.9) for z in (-0.9, 0, 0.9)])
        for geom in self._solids(thing):
            turn, at = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
            yield from grid * self._half(geom) @ turn.T + at


def _has_each(formula: ast.expr) -> bool:
    """Whether a `*` stands outside of every `count`."""
    counted = {
        id(inner)
        for node in ast.walk(formula)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "count"
        for inner in ast.walk(node)
    }
    return any(isinstance(n, ast.Name) and n.id == "_each_" and id(n) not in counted for n in ast.walk(formula))


def _measure_turn(rotation: Array) -> float:
    """Angle of a rotation (3, 3) [rad]."""
    return float(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))


def _agree(values: list[float]) -> float:
    """Of several meanings of a word: what all say, or open."""
    return min(values, key=abs) if min(values) * max(values) > 0 else 0.0


def _compare(value: float, relation: ast.cmpop, bound: float, unit: float) -> float:
    match relation:
        case ast.LtE() | ast.Lt():
            return (bound - value) / unit
        case ast.GtE() | ast.Gt():
            return (value - bound) / unit
        case ast.Eq():
            return SURE if abs(value - bound) < unit else -SURE
    raise ValueError(f"this judge cannot compare by {type(relation).__name__}")


def open_judge(room: Room, bundle: Path, before: Path | None = None, broken: frozenset[str] = frozenset()) -> Judge:
    """The end of a recorded session; `moved` counts from its own beginning, or from that of another bundle."""
    model = mujoco.MjModel.from_binary_path(str(bundle / "scene.mjb"))
    return Judge(room, model, _load(bundle / "terminal.npz"), _load((before or bundle) / "initial.npz"), broken)


def open_start(room: Room, bundle: Path) -> Judge:
    """The beginning of a recorded session."""
    model = mujoco.MjModel.from_binary_path(str(bundle / "scene.mjb"))
    begun = _load(bundle / "initial.npz")
    return Judge(room, model, begun, begun)


def _load(path: Path) -> Array:
    with np.load(path) as stored:
        return np.asarray(stored["state"])
