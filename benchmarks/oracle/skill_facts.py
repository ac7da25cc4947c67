"""What skills bring about beyond predicates of poses: a plugged peg, a swept area, poured balls."""

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np

from benchmarks.oracle.moment import Array, Moment, read_model, read_state
from benchmarks.oracle.predicates import REST_M_S, SURE, Judge

CELL_M, TOUCH_M, SWEPT = 0.005, 0.003, 0.95  # of a swept area
STILL_M, CLOSING_M = 0.0002, 0.005  # of fingers that hold something, in a control period
HELD_M = 0.06  # of the middle of what they hold from between the pads


class SkillJudge(Judge):
    """Judges the end of a bundle, compared with the start of another; what it adds is true or false for certain."""

    def __init__(self, bundle: Path, start: Path) -> None:
        model = read_model(bundle)
        now, before = (Moment(model, read_state(path)) for path in (bundle / "terminal.npz", start / "initial.npz"))
        super().__init__({}, {}, now, before)
        self._bundle = bundle

    def _is_plugged(self, peg: str, socket: str, deep_m: float, tall_m: float) -> float:
        """At rest and let go, with its lower end within the hole by half of its depth and more."""
        rim_m = self._now.locate(socket)[1][2] + 0.004 + 2 * deep_m
        lowest_m = self._now.locate(peg)[1][2] - tall_m
        is_free = self._now.find_touching(peg) <= {self._now.find(socket)}
        return _answer(rim_m - lowest_m >= deep_m and is_free and self._is_still(peg))

    def _is_beside(self, item: str, x_m: float, y_m: float, half_x_m: float, half_y_m: float) -> float:
        """At rest, with its origin outside of a rectangle."""
        x, y, _ = self._now.locate(item)[1]
        return _answer((abs(x - x_m) > half_x_m or abs(y - y_m) > half_y_m) and self._is_still(item))

    def _is_swept(self, block: str, x_m: float, y_m: float, half_x_m: float, half_y_m: float) -> float:
        """In the sessions of the goal, a held block touched all of a rectangle of the table, by the measured joints."""
        axes = [np.arange(c - h, c + h, CELL_M) for c, h in ((x_m, half_x_m), (y_m, half_y_m))]
        cells = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2) + CELL_M / 2
        swept = np.zeros(len(cells), dtype=bool)
        half = self._now.model.geom_size[self._now.model.body(block).geomadr[0]]
        for bundle in sorted(self._bundle.parent.glob(f"{self._bundle.name.split('.')[0]}.*")):
            for pose in _iter_held(self._now.model, block, bundle):
                if pose[2, 3] - np.abs(pose[2, :3]) @ half <= TOUCH_M:
                    local = (np.column_stack((cells, np.zeros(len(cells)))) - pose[:3, 3]) @ pose[:3, :3]
                    level = np.abs(pose[2, :3]) < 0.5
                    swept |= (np.abs(local)[:, level] <= half[level]).all(axis=1)
        return _answer(swept.mean() >= SWEPT)

    def _is_poured(self, cup: str, bowl: str, least: int) -> float:
        """At least so many of the cup's balls at rest, and borne by nothing but the bowl and each other."""
        names = [name for name in self._movable if name.startswith(f"{cup}.")]
        balls, own = {self._now.find(name): name for name in names}, self._now.find(bowl)
        touching = {ball: self._now.find_touching(name) for ball, name in balls.items()}
        inside, grown = {own}, True
        while grown:  # what touches the bowl, what touches that, ...
            reached = {ball for ball, others in touching.items() if others & inside} - inside
            inside, grown = inside | reached, bool(reached)
        kept = [ball for ball in inside - {own} if touching[ball] <= {*balls, own} and self._is_still(balls[ball])]
        return _answer(len(kept) >= least)

    def _is_still(self, item: str) -> bool:
        return self._now.measure_speed(item) < REST_M_S


def _answer(is_so: bool | np.bool_) -> float:
    return SURE if is_so else -SURE


def _iter_held(model: mujoco.MjModel, block: str, bundle: Path) -> Iterator[Array]:
    """World poses (4, 4) of a block while the fingers hold it, by the measured joints and where it was taken."""
    data, start = mujoco.MjData(model), Moment(model, read_state(bundle / "initial.npz")).data.body(block)
    with np.load(bundle / "trajectory.npz") as stored:
        joints, widths = stored["q_measured"], stored["gripper_measured_m"]
    closed = (np.abs(np.diff(widths)) < STILL_M) & (widths[1:] < np.max(widths, initial=0.0) - CLOSING_M)
    taken = None
    for row in np.flatnonzero(closed) + 1:
        for index, angle in enumerate(joints[row]):
            data.qpos[model.joint(f"joint{index + 1}").qposadr[0]] = angle
        mujoco.mj_kinematics(model, data)
        tool = _pose(data.site("tcp"))
        taken = np.linalg.inv(tool) @ _pose(start) if taken is None else taken
        if np.linalg.norm(taken[:3, 3]) < HELD_M:  # else something else is held
            yield tool @ taken


def _pose(frame: object) -> Array:
    """(4, 4) of a body or site of MuJoCo's data."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = frame.xmat.reshape(3, 3), frame.xpos  # type: ignore[attr-defined]
    return pose
