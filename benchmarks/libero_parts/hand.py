"""The world's own hand: puts things of a compiled MuJoCo model, and joints, where a benchmark wants them.

What it lets go falls, rolls or slides by physics, which its owner steps. Frames are the world's own.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from target_server.libero_body import Array
from target_server.mujoco_things import Mark, Thing

LET_GO_M = 0.003  # above what it falls on
STILL_M_S = 0.02
DRAWS = 16  # of the place of one thing, until it is free; each is nearer to the middle
DEEP_M = 0.004  # two solids that are further in each other share one place
LYING = 0.25  # share of things that are put on their side
MIDDLE_M = 0.03  # radius of the middle of a thing
ROOM_M = 0.1  # above a thing from which others are let go
WITHIN, AT_EDGE = (0.0, 0.85), (0.85, 1.6)  # of the half size of a place
BESIDE_M, FALL_M = (0.08, 0.25), (0.03, 0.15)  # from the place to where a thing is dropped, and how far it falls
DIVERGED = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)

Rng = np.random.Generator


class Crowded(Exception):
    """No free place was drawn for a thing."""


@dataclass(frozen=True)
class Spot:
    """A box of the world in which things are put.

    Attributes:
        center_m: (3,) its middle; `turn` (3, 3) from its own axes, z upwards, to the world.
        half_m: (2,) half sides across.
        top_m: Height from which things come.
        is_round: Whether the half sides are radii.
    """

    center_m: Array
    turn: Array
    half_m: Array
    top_m: float
    is_round: bool = False

    def draw(self, rng: Rng, span: tuple[float, float]) -> Array:
        """(2,) a point whose distance from the middle is within a span of the half size."""
        way = rng.uniform(-1.0, 1.0, 2)
        way /= np.linalg.norm(way) if self.is_round else np.abs(way).max()
        point: Array = self.center_m[:2] + self.turn[:2, :2] @ (way * rng.uniform(*span) * self.half_m)
        return point


class Hand:
    """Puts the things of one model.

    Args:
        model: Compiled.
        data: Its state, which is changed.
        things: Of the model; those that are free, or have a joint, can be put.
    """

    def __init__(self, model: Any, data: Any, things: Sequence[Thing]) -> None:
        self._model, self._data, self.things = model, data, things

    def put(self, thing: Thing, spot: Spot, rng: Rng, span: tuple[float, float]) -> None:
        """Let a thing go over a point of a spot where it is free; raises `Crowded`."""
        upright = self._data.xmat[thing.body].reshape(3, 3).copy()
        for draw in range(DRAWS):
            narrow = 1.0 - draw / DRAWS if span is WITHIN else 1.0
            point = spot.draw(rng, (span[0] * narrow, span[1] * narrow))
            turn = _draw_turn(rng) @ upright
            self._place(thing, point, turn, self._find_floor(thing, point, turn, spot.top_m) + LET_GO_M)
            if self._is_free(thing):
                return
        raise Crowded(thing.name)

    def let_fall(self, thing: Thing, spot: Spot, rng: Rng) -> None:
        """Drop a thing beside a spot, from a hand's height, however it is turned; raises `Crowded`."""
        upright = self._data.xmat[thing.body].reshape(3, 3).copy()
        for _ in range(DRAWS):
            angle = rng.uniform(-np.pi, np.pi)
            point = spot.center_m[:2] + rng.uniform(*BESIDE_M) * np.array((np.cos(angle), np.sin(angle)))
            turn = _draw_turn(rng) @ upright
            floor_m = self._find_floor(thing, point, turn, spot.top_m + ROOM_M)
            self._place(thing, point, turn, floor_m + rng.uniform(*FALL_M))
            if self._is_free(thing):
                return
        raise Crowded(thing.name)

    def _place(self, thing: Thing, point: Array, turn: Array, lowest_m: float) -> None:
        """Put the origin of a thing over a point (2,), turned (3, 3), with its lowest corner at a height."""
        joint = int(self._model.body_jntadr[thing.body])
        at, dof = int(self._model.jnt_qposadr[joint]), int(self._model.jnt_dofadr[joint])
        self._data.qpos[at : at + 3] = *point, lowest_m - _list_corners(thing, turn)[:, 2].min()
        mujoco.mju_mat2Quat(self._data.qpos[at + 3 : at + 7], turn.ravel())
        self._data.qvel[dof : dof + 6] = 0.0
        mujoco.mj_forward(self._model, self._data)

    def move(self, thing: Thing, low: float, high: float, rng: Rng) -> None:
        """Bring a joint to a share of its travel, drawn between two; raises `Crowded`."""
        joint = thing.joint
        assert joint is not None
        share = float(np.clip(rng.uniform(low, high), 0.0, 1.0))
        self._data.qpos[joint.address] = joint.closed + share * (joint.opened - joint.closed)
        self._data.qvel[self._model.jnt_dofadr[self._model.body_jntadr[thing.body]]] = 0.0
        mujoco.mj_forward(self._model, self._data)
        if not self._is_free(thing):
            raise Crowded(thing.name)

    def _find_floor(self, thing: Thing, point: Array, turn: Array, top_m: float) -> float:
        """Height of the highest surface below a height under five points of a thing that is over a point (2,)."""
        half_m = np.abs(_list_corners(thing, turn)[:, :2]).max(axis=0)
        self._place(thing, point, turn, top_m + 10.0)  # away: rays meet the others alone
        groups, hit = np.array((1, 0, 0, 0, 0, 0), dtype=np.uint8), np.zeros(1, dtype=np.int32)
        heights = [0.0]
        for aside in ((0.0, 0.0), (0.6, 0.6), (0.6, -0.6), (-0.6, 0.6), (-0.6, -0.6)):
            start = np.array((*(point + np.array(aside) * half_m), top_m))
            down = mujoco.mj_ray(self._model, self._data, start, np.array((0.0, 0.0, -1.0)), groups, 1, -1, hit)
            heights.append(top_m - down if down >= 0.0 else 0.0)
        return max(heights)

    def _is_free(self, thing: Thing) -> bool:
        """Whether it shares its place with nothing."""
        own = set(thing.geoms)
        pairs = zip(self._data.contact.geom.tolist(), self._data.contact.dist.tolist(), strict=True)
        return not any(depth < -DEEP_M and (a in own) != (b in own) for (a, b), depth in pairs)

    def find_spot(self, name: str) -> Spot:
        """Of a mark, or the middle of a thing, where they are now."""
        marked: list[tuple[Thing, Mark]] = [(thing, mark) for thing in self.things for mark in thing.marks]
        for thing, mark in marked:
            if mark.name == name:
                turn = self._data.xmat[thing.body].reshape(3, 3)
                center_m = self._data.xpos[thing.body] + turn @ mark.center_m
                return Spot(center_m, turn @ mark.rotation, mark.half_m[:2], float(center_m[2] + mark.half_m[2]))
        thing = self.get(name)
        center_m, turn = self._data.xpos[thing.body].copy(), self._data.xmat[thing.body].reshape(3, 3)
        top_m = float(center_m[2] + _list_corners(thing, turn)[:, 2].max()) + ROOM_M
        return Spot(center_m, np.eye(3), np.full(2, MIDDLE_M), top_m, is_round=True)

    def is_sound(self) -> bool:
        """Whether the simulation has not diverged since the state was set anew."""
        return not any(self._data.warning[each].number for each in DIVERGED)

    def is_still(self) -> bool:
        """Whether every free thing rests."""
        return all(np.linalg.norm(self._data.cvel[each.body][3:]) < STILL_M_S for each in self.list_free())

    def find_mechanism(self, name: str) -> Thing:
        """What has the joint that a name of the goal stands for."""
        marked = [each for each in self.things if each.joint and any(mark.name == name for mark in each.marks)]
        return (marked or [each for each in self.things if each.joint and each.owner == name])[0]

    def get(self, name: str) -> Thing:
        """The thing of a name."""
        return next(each for each in self.things if each.name == name)

    def list_free(self) -> list[Thing]:
        """What can be put anywhere."""
        return [each for each in self.things if each.movable and each.joint is None and not each.part_of]


def _draw_turn(rng: Rng) -> Array:
    """(3, 3) about the vertical; of some things on their side before."""
    turn, yaw, tilt = np.empty(9), np.empty(4), np.array((1.0, 0.0, 0.0, 0.0))
    mujoco.mju_axisAngle2Quat(yaw, np.array((0.0, 0.0, 1.0)), rng.uniform(-np.pi, np.pi))
    if rng.random() < LYING:
        angle = rng.uniform(-np.pi, np.pi)
        mujoco.mju_axisAngle2Quat(tilt, np.array((np.cos(angle), np.sin(angle), 0.0)), np.pi / 2)
    both = np.empty(4)
    mujoco.mju_mulQuat(both, yaw, tilt)
    mujoco.mju_quat2Mat(turn, both)
    return turn.reshape(3, 3)


def _list_corners(thing: Thing, turn: Array) -> Array:
    """(n, 3) of the boxes around its solids, from its origin, as it is turned."""
    corners: Array = np.concatenate([solid.corners_m for solid in thing.solids]) @ turn.T
    return corners
