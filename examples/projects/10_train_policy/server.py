"""Serves a trained policy: ONNX behind `phyagentos.runtime.policies.policy_server`, its rows followed within limits.

    python server.py weights/state.onnx       # for the skill pick_by_state
    python server.py weights/image.onnx       # for pick_by_image

A network answers with where the arm was at such moments of its demonstrations, which no arm reaches at once. What is
answered here goes on from the set-point in force, with its velocity, towards those rows as fast as the limits permit.
"""

import argparse
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from phyagentos.protocol.capabilities.skill_runtimes import read_skill
from phyagentos.runtime.policies.policy_server import serve_policy
from phyagentos.runtime.policies.wire import Infer, Start

MODEL_S, PERIOD_S = 0.04, 0.02  # between rows of the model, and between those of an answer
VELOCITY_RAD_S = 0.8 * np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61])  # of the robot's limits
ACCELERATION_RAD_S2 = 0.6 * np.array([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0])
STIFFNESS_RAD_S = 12.0
OPEN_M, HALF_OPEN_M = 0.08, 0.04
STILL_RAD = 0.02  # rows that lead nowhere are the last ones; so are those that follow when the hand has let go
PICTURE = (64, 48)  # width, height


@dataclass(slots=True)
class Tracker:
    """Follows rows of joint positions from the set-point in force: critically damped, within limits.

    Attributes:
        model_s: Between rows of the model; `period_s` between those of an answer.
        velocity_rad_s: (7,) limits, as `acceleration_rad_s2`.
        stiffness_rad_s: Natural frequency of the tracker [rad/s].
    """

    model_s: float = MODEL_S
    period_s: float = PERIOD_S
    velocity_rad_s: np.ndarray = field(default_factory=lambda: VELOCITY_RAD_S)
    acceleration_rad_s2: np.ndarray = field(default_factory=lambda: ACCELERATION_RAD_S2)
    stiffness_rad_s: float = STIFFNESS_RAD_S
    _sent: np.ndarray = field(default_factory=lambda: np.zeros((0, 2, 7)))  # after each row of the latest chunk
    _began: int = 0  # rows that had been carried out before it

    def follow(self, wanted_rad: np.ndarray, rows_done: int, measured_rad: np.ndarray) -> np.ndarray:
        """(n, 7) rows of an answer towards (k, 7) rows of the model, of as much time."""
        rest = np.stack((measured_rad, np.zeros(7)))
        q, qd = self._sent[min(rows_done - self._began, len(self._sent) - 1)] if len(self._sent) else rest
        count, step_s, stiffness = len(wanted_rad), self.period_s, self.stiffness_rad_s
        knots_s = self.model_s * np.arange(1, count + 1)
        times_s = step_s * np.arange(1, round(count * self.model_s / step_s) + 1)
        wanted = np.column_stack([np.interp(times_s, knots_s, joint) for joint in smooth(wanted_rad).T])
        speed = np.gradient(wanted, step_s, axis=0)
        sent = [(q, qd)]
        for goal, ahead in zip(wanted, speed, strict=True):
            back = stiffness**2 * (goal - q - step_s * qd) + 2.0 * stiffness * (ahead - qd)
            qdd = np.clip(back, -self.acceleration_rad_s2, self.acceleration_rad_s2)
            qdd = np.clip(qdd, (-self.velocity_rad_s - qd) / step_s, (self.velocity_rad_s - qd) / step_s)
            q, qd = q + step_s * qd + step_s**2 / 2.0 * qdd, qd + step_s * qdd
            sent.append((q, qd))
        self._sent, self._began = np.array(sent), rows_done
        return self._sent[1:, 0]


def smooth(rows: np.ndarray) -> np.ndarray:
    """Each row's mean with its neighbours: the network answers row by row."""
    padded = np.vstack((rows[:1], rows, rows[-1:]))
    return (padded[:-2] + 2.0 * rows + padded[2:]) / 4.0


class TrainedPolicy:
    """Asks the model once a chunk. A picture, like a pose, is that of before the first command."""

    def __init__(self, model: Path) -> None:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        self._model: Any = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
        self._sees = self._model.get_inputs()[2].name
        self.skill = "pick_by_state" if self._sees == "pose" else "pick_by_image"
        self.start(Start("", "", {}, 0))

    def start(self, request: Start) -> None:
        self._tracker, self._seen, self._hand, self._has_closed = Tracker(), np.zeros(0), OPEN_M, False

    def infer(self, request: Infer) -> tuple[np.ndarray, bool]:
        shown = request.observations
        if not self._seen.size:
            self._seen = self._look(shown)
        joints, opening = shown["joint_state"], shown["gripper_width"].reshape(1)
        fed = {"joint_state": joints[None].astype(np.float32), "gripper_width": opening[None].astype(np.float32)}
        wanted = self._model.run(None, fed | {self._sees: self._seen})[0][0].astype(np.float64)
        rows = self._tracker.follow(wanted[:, :-1], request.rows_done, joints)
        hand = np.where(np.repeat(wanted[:, -1], 2) > HALF_OPEN_M, OPEN_M, 0.0)
        leads = np.abs(wanted[:, :-1] - joints).max() > STILL_RAD or (hand != self._hand).any()
        let_go = self._has_closed and opening[0] > OPEN_M - 0.01 and (hand > 0.0).all()
        self._hand, self._has_closed = hand[0], self._has_closed or hand[0] == 0.0
        return np.column_stack((rows, hand)), bool(let_go or not leads)

    def _look(self, shown: dict[str, np.ndarray]) -> np.ndarray:
        if self._sees == "pose":
            return shown["environment_state"][:1].astype(np.float32)
        return cv2.resize(shown["camera_rgb"], PICTURE, interpolation=cv2.INTER_AREA)[None]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("--endpoint", default="")
    given = parser.parse_args()
    policy = TrainedPolicy(given.model)
    declared = read_skill(Path(__file__).parent / "skills" / policy.skill / "SKILL.md")[0].policy
    assert declared is not None
    descriptor = declared if not given.endpoint else declared.model_copy(update={"endpoint": given.endpoint})
    serve_policy(policy, descriptor, lambda where: print(f"serving at {where}", flush=True))


if __name__ == "__main__":
    main()
