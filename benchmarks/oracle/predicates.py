"""Whether predicates are true, from a recorded simulator state and the places that a room declares.

Every answer is a number in units of its own tolerance: 1 and more is true, -1 and less is false, between them two
honest judges may differ (1 mm, 1 degree). `and` takes the least, `or` the greatest. What stands *on* something is borne
by it, as contact forces show, with its middle over it. What is *inside*, *on* or *at* a place has been let go of, and
rests.
"""

import ast
import operator
from collections.abc import Iterator, Mapping
from pathlib import Path

import mujoco
import numpy as np
import yaml

from benchmarks.oracle.moment import GEOM, Array, Moment

Box = tuple[Array, Array]
"""Centre (3,) and half extents (3,)."""

UNIT_M, UNIT_RAD = 0.001, np.radians(1.0)
CLEAR = 2.5  # tolerances from which cameras, too, can tell
SURE = 99.0
RIM_M, FLOOR_M, EDGE_M = 0.003, 0.010, 0.005  # as the predicates are documented
MOVED_M, MOVED_RAD = 0.015, np.radians(10)
UPRIGHT_RAD, FALLEN_RAD = 0.26, 0.79
OPEN, CLOSED = 0.9, 0.1  # shares of the travel
REST_M_S = 0.03  # faster objects do not rest
TOUCH_N = 0.05
FINGERS = ("left_finger", "right_finger")
_RELATIONS = {ast.LtE: operator.le, ast.Lt: operator.lt, ast.GtE: operator.ge, ast.Gt: operator.gt, ast.Eq: operator.eq}
SENSORS = Path(__file__).resolve().parents[2] / "protocol" / "sensors.yaml"


class Judge:
    """Looks at one moment of one world.

    Args:
        interiors: Body -> where objects are put into it, in its frame.
        regions: Region -> its box in the world.
        now: What is judged.
        before: That from which `moved` counts.
        broken: Names of cameras that something is wrong with; `*` means all.
        is_live: Whether `visible` asks for this moment alone; else what any camera had in view before is open.
    """

    def __init__(
        self,
        interiors: Mapping[str, Box],
        regions: Mapping[str, Box],
        now: Moment,
        before: Moment,
        broken: frozenset[str] = frozenset(),
        *,
        is_live: bool = False,
    ) -> None:
        self._boxes, self._regions, self._broken = {**interiors, **regions}, frozenset(regions), broken
        self._now, self._before, self._is_live = now, before, is_live
        self._movable = now.list_free()
        self._fingers = [name for name in FINGERS if self._is_exists(name) > 0]

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

    def _is_inside(self, item: str, place: str) -> float:
        (turn, at), (center, half) = self._frame_of(place), self._box_of(place)
        if not half.any():
            return -SURE
        middle = turn.T @ (self._now.find_middle(item) - at) - center
        up = turn[:, 2]
        low = -self._now.measure_reach(item, -up) - float(up @ at) - center[2]
        slack = (*(half[:2] - abs(middle[:2])), half[2] - RIM_M - low, low + half[2] + FLOOR_M)
        return float(min(*(each / UNIT_M for each in slack), self._rests(item)))

    def _is_on(self, item: str, support: str) -> float:
        weight = float(self._now.model.body_mass[self._now.find(item)]) * 9.81
        borne = (self._now.sum_force(item, support)[2] / weight - 0.5) / 0.125
        over = (self._now.measure_room(support, self._now.find_middle(item)) + EDGE_M) / UNIT_M
        return float(min(max(borne, -SURE), over, self._rests(item)))

    def _is_at(self, item: str, place: str | Array, tol_m: float = 0.03) -> float:
        return min((float(tol_m) - self._distance(item, place)) / UNIT_M, self._rests(item))

    def _is_near(self, item: str, other: str, tol_m: float = 0.10) -> float:
        values = [(float(tol_m) - far) / UNIT_M for far in self._list_distances(item, other)]
        return _agree(values)

    def _is_upright(self, item: str) -> float:
        return _agree([float((UPRIGHT_RAD - tilt) / UNIT_RAD) for tilt in self._list_tilts(item)])

    def _is_fallen(self, item: str) -> float:
        return _agree([float((tilt - FALLEN_RAD) / UNIT_RAD) for tilt in self._list_tilts(item)])

    def _is_moved(self, item: str) -> float:
        (now, here), (then, there) = self._now.locate(item), self._before.locate(item)
        way = float(np.linalg.norm(here - there))
        turns = (_measure_turn(now.T @ then), self._measure_shown_turn(item))
        return _agree([float(max((way - MOVED_M) / UNIT_M, (turn - MOVED_RAD) / UNIT_RAD)) for turn in turns])

    def _is_holding(self, _target: str, item: str) -> float:
        return SURE if self._is_held(item) else -SURE

    def _is_exists(self, item: str) -> float:
        return SURE if mujoco.mj_name2id(self._now.model, mujoco.mjtObj.mjOBJ_BODY, item) >= 0 else -SURE

    def _is_open(self, item: str) -> float:
        return self._measure_ajar(item, OPEN)

    def _is_closed(self, item: str) -> float:
        return -self._measure_ajar(item, CLOSED)

    def _measure_ajar(self, item: str, least: float) -> float:
        """How far it is open beyond a share of its travel, in tolerances."""
        share, travel = self._now.measure_opening(item)
        joint = self._now.model.body_jntadr[self._now.find(item)]
        is_slide = self._now.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
        return (share - least) * travel / (UNIT_M if is_slide else UNIT_RAD)

    def _is_visible(self, item: str) -> float:
        """Seen by a sound camera now; what another one has in view, or any had before where that counts, is open."""
        cameras = self._read_cameras()
        sound = [camera for name, camera in cameras.items() if not self._broken & {name, "*"}]
        if max((self._see(item, camera, self._now) for camera in sound), default=0.0) >= 0.15:
            return SURE
        moments = (self._now,) if self._is_live else (self._now, self._before)
        return 0.0 if any(self._see(item, each, at) for each in cameras.values() for at in moments) else -SURE

    # -- numbers -------------------------------------------------------------------------------------------------------

    def _measure_tilt(self, item: str) -> tuple[float, float]:
        own, least = self._list_tilts(item)
        return (own + least) / 2, UNIT_RAD + (own - least) / 2

    def _measure_height(self, item: str) -> tuple[float, float]:
        return self._now.find_lowest(item), UNIT_M

    def _measure_distance(self, item: str, other: str) -> tuple[float, float]:
        found = self._list_distances(item, other)
        return sum(found) / len(found), UNIT_M + (max(found) - min(found)) / 2

    def _measure_speed(self, item: str) -> tuple[float, float]:
        return self._now.measure_speed(item), 0.005

    # -- geometry ------------------------------------------------------------------------------------------------------

    def _frame_of(self, place: str) -> tuple[Array, Array]:
        return (np.eye(3), np.zeros(3)) if place in self._regions else self._now.locate(place)

    def _box_of(self, place: str) -> Box:
        """Of a region or an interior, in its frame; no extents without one."""
        return self._boxes.get(place, (np.zeros(3), np.zeros(3)))

    def _list_tilts(self, name: str) -> tuple[float, float]:
        """Angle of its z axis to the vertical, and the least of all axes that look as this one does [rad]."""
        now, (turn, _), solids = self._now, self._now.locate(name), self._now.list_solids(name)
        own = float(np.arccos(np.clip(turn[2, 2], -1, 1)))
        if len(solids) > 1:
            return own, own
        axes, half = now.data.geom_xmat[solids[0]].reshape(3, 3), now.find_half(solids[0])
        along = int(np.argmax(abs(axes.T @ turn[:, 2])))  # the axis of the solid that is the body's z
        alike = abs(half - half[along]) < UNIT_M
        is_round = now.model.geom_type[solids[0]] != GEOM.mjGEOM_BOX
        rise = float(np.linalg.norm(axes[2, alike]) if is_round else abs(axes[2, alike]).max())
        return own, min(own, float(np.arccos(min(1.0, rise))))

    def _measure_shown_turn(self, name: str) -> float:
        """How far it has turned since the beginning, but for turns of a round solid about its axis [rad]."""
        moments, solids = (self._now, self._before), self._now.list_solids(name)
        kind = GEOM(self._now.model.geom_type[solids[0]])
        if len(solids) > 1 or kind == GEOM.mjGEOM_BOX:
            now, then = (each.locate(name)[0] for each in moments)
            return _measure_turn(now.T @ then)
        axes = [each.data.geom_xmat[solids[0]].reshape(3, 3)[:, 2] for each in moments]
        return 0.0 if kind == GEOM.mjGEOM_SPHERE else float(np.arccos(min(1.0, abs(axes[0] @ axes[1]))))

    def _distance(self, item: str, place: str | Array) -> float:
        """From the middle of an object to a point, or to the box of a place."""
        middle = self._now.find_middle(item)
        if not isinstance(place, str):
            return float(np.linalg.norm(middle - place))
        (turn, at), (center, half) = self._frame_of(place), self._box_of(place)
        if not half.any():
            return float(np.linalg.norm(middle - self._now.find_middle(place)))
        local = turn.T @ (middle - at) - center
        return float(np.linalg.norm(np.maximum(abs(local) - half, 0.0)))

    def _list_distances(self, item: str, other: str) -> list[float]:
        """Between middles; what has an interior has two middles."""
        points = [self._now.find_middle(other)] if other not in self._regions else []
        center, half = self._box_of(other)
        if half.any():
            turn, at = self._frame_of(other)
            points.append(turn @ center + at)
        return [float(np.linalg.norm(self._now.find_middle(item) - point)) for point in points]

    def _rests(self, name: str) -> float:
        """Let go of, and not moving."""
        return -SURE if self._is_held(name) else (REST_M_S - self._now.measure_speed(name)) / 0.01

    def _is_held(self, name: str) -> bool:
        forces = [np.linalg.norm(self._now.sum_force(name, finger)) for finger in self._fingers]
        return bool(forces) and min(forces) > TOUCH_N

    # -- sight ---------------------------------------------------------------------------------------------------------

    def _read_cameras(self) -> dict[str, dict[str, object]]:
        sensors = yaml.safe_load(SENSORS.read_text())["sensors"]
        rgbd = {name: sensor["camera"] for name, sensor in sensors.items() if sensor["modality"] == "rgbd"}
        return {name: camera for name, camera in rgbd.items() if "scene_camera" not in camera}  # rooms have none

    def _see(self, item: str, camera: dict[str, object], moment: Moment) -> float:
        """Share of points of an object that a camera has in its picture with nothing before them."""
        start, look, up = (np.array(camera.get(key, (0.0, 0.0, 1.0))) for key in ("position_m", "target_m", "up"))
        if "mount" in camera:
            turn, at = moment.locate(str(camera["mount"]))
            start, look, up = turn @ start + at, turn @ look + at, turn @ up
        axis = (look - start) / np.linalg.norm(look - start)
        aside = np.cross(axis, up) / np.linalg.norm(np.cross(axis, up))
        width, height, fovy = (float(str(camera[key])) for key in ("width", "height", "fovy_deg"))
        high = np.tan(np.radians(fovy) / 2)
        wide = high * width / height
        points, own, seen = list(_iter_points(item, moment)), moment.find(item), 0
        for point in points:
            ray, geom = point - start, np.zeros(1, dtype=np.int32)
            depth = float(axis @ ray)
            if abs(aside @ ray) > wide * depth or abs(np.cross(aside, axis) @ ray) > high * depth:
                continue
            mujoco.mj_ray(moment.model, moment.data, start, ray, None, 1, -1, geom)
            seen += bool(geom[0] >= 0 and moment.model.geom_bodyid[geom[0]] == own)
        return seen / len(points)


def _iter_points(item: str, moment: Moment) -> Iterator[Array]:
    grid = np.array([[x, y, z] for x in (-0.9, 0, 0.9) for y in (-0.9, 0, 0.9) for z in (-0.9, 0, 0.9)])
    for geom in moment.list_solids(item):
        turn, at = moment.data.geom_xmat[geom].reshape(3, 3), moment.data.geom_xpos[geom]
        yield from grid * moment.find_half(geom) @ turn.T + at


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
