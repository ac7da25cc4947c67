"""Scripted motions of FrankaKitchen's arm behind openpi's wire, from an environment that has it.

    build/kitchen/bin/python examples/projects/09_franka_kitchen/motions.py [--port 8766]

The words of a session name a subtask ("light switch"). Its motion is computed once, from the first observation (59,):
points for the fingertips about a handle of the environment's own model, inverse kinematics, and what gravity asks of
the motors. A policy that has learnt nothing, knows the geometry, and does not look again on the way.
"""

import argparse
from collections.abc import Iterator
from typing import Any

import gymnasium
import gymnasium_robotics
import msgpack
import mujoco
import numpy as np
from numpy.typing import NDArray
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

Array = NDArray[np.float64]
STEP_S, CHUNK = 0.08, 20
REACH_M = 0.05  # from the hand's site to the fingertips
OPEN_M, CLOSED_M = 0.04, 0.0
ARM, FINGERS = slice(0, 7), slice(7, 9)
POINT_M = 0.05  # between points of a straight line
JOINT_RAD_S = 1.0
LOW = np.array([-2.85, -1.79, -2.85, -3.05, -2.85, 0.02, -2.85])
HIGH = np.array([2.85, 1.79, 2.85, -0.41, 2.85, 3.70, 2.85])
AHEAD, RIGHT, UP = np.eye(3)[[1, 0, 2]]


class Arm:
    """The arm's kinematics: fingertips, where they point, and along what they close."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model, self.data = model, mujoco.MjData(model)
        self._hand = model.site("end_effector").id
        self._finger = model.joint("robot:panda0_finger_joint1").id
        self._stiffness = model.actuator_gainprm[ARM, 0]

    def place(self, q: Array) -> tuple[Array, Array, Array]:
        """Fingertips (3,), direction of approach (3,), of closing (3,)."""
        self.data.qpos[: len(q)] = q
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        closing = self.data.xaxis[self._finger]
        ahead = self.data.xpos[self.model.jnt_bodyid[self._finger]] - self.data.site_xpos[self._hand]
        rotation = self.data.site_xmat[self._hand].reshape(3, 3).T
        axis = rotation[np.abs(rotation @ -ahead).argmax()]
        axis = axis * np.sign(axis @ -ahead)
        return self.data.site_xpos[self._hand] + REACH_M * axis, axis, closing.copy()

    def solve(self, q: Array, tip_m: Array, ahead: Array, closing: Array | None, weight: float = 0.15) -> Array:
        """Joint positions near `q` with the fingertips there, by damped least squares."""
        q, jacobian, turning = q.copy(), np.zeros((3, self.model.nv)), np.zeros((3, self.model.nv))
        for _ in range(60):
            found_m, axis, close = self.place(q)
            mujoco.mj_jac(self.model, self.data, jacobian, turning, found_m, self.model.site_bodyid[self._hand])
            errors, rows = [tip_m - found_m, weight * np.cross(axis, ahead)], [jacobian, weight * turning]
            if closing is not None:
                errors.append(weight * np.cross(close, closing * np.sign(closing @ close)))
                rows.append(weight * turning)
            a, b = np.vstack(rows)[:, ARM], np.concatenate(errors)
            change = a.T @ np.linalg.solve(a @ a.T + 1e-4 * np.eye(len(b)), b)
            q[ARM] = np.clip(q[ARM] + np.clip(change, -0.1, 0.1), LOW, HIGH)
        return q

    def reach(self, q: Array, tip_m: Array, ahead: Array, closing: Array | None, roll_rad: float = 0.0) -> Array:
        """As `solve`; from other postures as well where that leads nowhere, or leaves no room to roll, and the best."""
        chance, best, least = np.random.default_rng(0), q, np.inf
        for attempt in range(25):
            start = q.copy()
            start[ARM] = np.clip(q[ARM] + (0.5 * chance.normal(size=7) if attempt else 0.0), LOW, HIGH)
            start[6] -= roll_rad if attempt else 0.0
            found = self.solve(start, tip_m, ahead, closing)
            at_m, axis, close = self.place(found)
            off = 1.0 - axis @ ahead + (0.0 if closing is None else 1.0 - abs(close @ closing))
            away_m, far = float(np.linalg.norm(tip_m - at_m)), float(np.abs(found - q)[ARM].max())
            lacking = max(0.0, found[6] + roll_rad - HIGH[6])
            cost = 50.0 * away_m + 0.7 * off + 0.25 * far + 10.0 * lacking
            if cost < least:
                best, least = found, cost
            if not attempt and away_m < 0.003 and off < 0.15 and not lacking:
                break
        return best

    def bear(self, q: Array) -> Array:
        """Set-points (9,) that hold the arm at `q` against gravity."""
        self.data.qpos[: len(q)], self.data.qvel[:] = q, 0.0
        mujoco.mj_forward(self.model, self.data)
        held = q.copy()
        held[ARM] += self.data.qfrc_bias[ARM] / self._stiffness
        return held


class Motion:
    """Rows of set-points (9,), one a step, that are appended to by what the hand does."""

    def __init__(self, arm: Arm, q: Array) -> None:
        self._arm, self.q, self.rows = arm, q.copy(), list[Array]()

    def move(
        self,
        tip_m: Array,
        closing: Array | None = None,
        ahead: Array = AHEAD,
        speed_m_s: float = 0.3,
        roll_rad: float = 0.0,
    ) -> None:
        """Bring the fingertips there on a straight line; from there the hand could roll by so much."""
        start_m = self._arm.place(self.q)[0]
        points = max(1, int(np.ceil(np.linalg.norm(tip_m - start_m) / POINT_M))) if speed_m_s <= 0.3 else 1
        for point in range(1, points + 1):
            at_m = self._arm.place(self.q)[0]
            to_m = start_m + (tip_m - start_m) * point / points
            goal = self._arm.reach(self.q, to_m, ahead / np.linalg.norm(ahead), closing, roll_rad)
            goal[FINGERS] = self.q[FINGERS]
            far_s = max(np.linalg.norm(to_m - at_m) / speed_m_s, np.abs(goal - self.q)[ARM].max() / JOINT_RAD_S)
            self._go(goal, max(1, int(np.ceil(far_s / STEP_S))))

    def grip(self, width_m: float, steps: int = 6) -> None:
        """Bring both fingers there; an object between them is pressed."""
        self.q[FINGERS] = width_m
        self._go(self.q, steps)

    def roll(self, angle_rad: float, steps: int) -> None:
        """Turn the hand about the direction of approach."""
        goal = self.q.copy()
        goal[6] = min(goal[6] + angle_rad, HIGH[6])
        self._go(goal, steps)

    def _go(self, goal: Array, steps: int) -> None:
        start = self.q
        self.rows += [self._arm.bear(start + (goal - start) * step / steps) for step in range(1, steps + 1)]
        self.q = goal.copy()


def plan(arm: Arm, seen: Array, task: str) -> list[Array]:
    """The rows of a subtask, from the observation (59,) at its beginning."""
    arm.data.qpos[9:] = seen[18:39]
    motion = Motion(arm, seen[:9])
    tip_m, sites = arm.place(seen[:9])[0], arm.data.site
    motion.grip(OPEN_M, 4)  # of what the last subtask has left in the hand
    motion.move(np.array([tip_m[0], min(tip_m[1], 0.45), tip_m[2]]), speed_m_s=0.5)
    at_m = {name: sites(site).xpos.copy() for name, site in HANDLES.items()}[task]
    if task in {"bottom burner", "top burner"}:
        turned_rad = -float(arm.data.joint(KNOBS[task]).qpos[0])
        across, left_rad = np.cos(turned_rad) * RIGHT - np.sin(turned_rad) * UP, KNOB_RAD - turned_rad
        motion.move(at_m - 0.14 * AHEAD, across, speed_m_s=0.5, roll_rad=left_rad)
        motion.move(at_m + 0.015 * AHEAD, across, roll_rad=left_rad)
        motion.grip(CLOSED_M)
        motion.roll(left_rad, 18)
    elif task == "hinge cabinet":
        motion.move(at_m - 0.15 * AHEAD, RIGHT, speed_m_s=0.5)
        motion.move(at_m + 0.025 * AHEAD, RIGHT)
        motion.grip(CLOSED_M, 7)
        axis_m = arm.data.xanchor[arm.model.joint("right_hinge_cabinet").id]
        for angle_rad in np.linspace(0.1, 1.75, 18):
            c, s = np.cos(angle_rad), np.sin(angle_rad)
            turned_m = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ (at_m + 0.02 * AHEAD - axis_m)
            ahead = np.sin(angle_rad / 2) * RIGHT + np.cos(angle_rad / 2) * AHEAD
            motion.move(axis_m + turned_m, ahead=ahead, speed_m_s=0.2)
    else:
        motion.grip(CLOSED_M, 3)
        side, way_m = (1.0, 0.27) if task == "light switch" else (-1.0, 0.52)
        motion.move(at_m + 0.09 * side * RIGHT - 0.14 * AHEAD, speed_m_s=0.5)
        motion.move(at_m + 0.08 * side * RIGHT)
        motion.move(at_m + (0.08 - way_m) * side * RIGHT + 0.02 * (side > 0) * AHEAD)
    return motion.rows


KNOB_RAD = 1.3  # beyond what is asked for: the fingers slip
KNOBS = {"bottom burner": "knob_Joint_2", "top burner": "knob_Joint_4"}
HANDLES = {
    "bottom burner": "knob2_site", "top burner": "knob4_site", "light switch": "light_site",
    "slide cabinet": "slide_site", "hinge cabinet": "hinge_site2",
}  # fmt: skip


def iter_chunks(arm: Arm, seen: Array, task: str) -> Iterator[Array]:
    """The rows, some at a time; the last one again and again behind them."""
    rows = plan(arm, seen, task)
    for first in range(0, len(rows), CHUNK):
        yield np.array(rows[first : first + CHUNK])
    while True:
        yield np.array(rows[-1:])


def main() -> None:
    """Serve until interrupted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--port", type=int, default=8766)
    gymnasium.register_envs(gymnasium_robotics)
    model = gymnasium.make("FrankaKitchen-v1", disable_env_checker=True).unwrapped.model

    def receive(connection: ServerConnection) -> None:
        connection.send(msgpack.packb({"policy": "kitchen/scripted"}))
        chunks: Iterator[Array] | None = None
        try:
            for message in connection:
                asked = msgpack.unpackb(message)
                if asked["prompt"] not in HANDLES:
                    connection.send(f"no motion for {asked['prompt']!r}; there are {', '.join(HANDLES)}")
                    continue
                if chunks is None:
                    chunks = iter_chunks(Arm(model), decode(asked["observation/state"]), asked["prompt"])
                connection.send(msgpack.packb({"actions": encode(next(chunks))}))
        except ConnectionClosed:
            return

    with serve(receive, "127.0.0.1", parser.parse_args().port, compression=None) as server:
        server.serve_forever()


def encode(array: NDArray[Any]) -> dict[bytes, Any]:
    """An array as openpi's messages have it."""
    return {b"__ndarray__": True, b"data": array.tobytes(), b"dtype": array.dtype.str, b"shape": array.shape}


def decode(value: dict[bytes, Any]) -> NDArray[Any]:
    """The array of such a map."""
    return np.frombuffer(value[b"data"], dtype=value[b"dtype"]).reshape(value[b"shape"]).copy()


if __name__ == "__main__":
    main()
