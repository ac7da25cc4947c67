"""The policy that puts one object into or onto another, for `paos policy serve`: ONNX, its rows followed within limits.

paos policy serve skills/place_learned/SKILL.md place_policy.py:PlacePolicy --endpoint openpi://127.0.0.1:8010
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np

from phyagentos.runtime.policies.wire import Infer, Start

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "examples" / "projects" / "10_train_policy"))
from server import HALF_OPEN_M, OPEN_M, STILL_RAD, Tracker

MODEL = Path(__file__).with_name("place.onnx")
PERIOD_S = 0.05
VELOCITY_RAD_S = 0.8 * np.array([0.5, 0.5, 0.5, 0.6, 1.0, 1.0, 1.2])  # of the robot's limits
STIFFNESS_RAD_S = 6.0  # at twenty rows a second
ACCELERATION_RAD_S2 = 0.6 * np.array([2.0, 2.0, 2.0, 2.0, 4.0, 4.0, 4.0])


class PlacePolicy:
    """Asks the model once a chunk. Poses are of before the first command; time tells where demonstrations dwell."""

    def __init__(self) -> None:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        self._model: Any = onnxruntime.InferenceSession(MODEL, options, providers=["CPUExecutionProvider"])
        self.start(Start("", "", {}, 0))

    def start(self, request: Start) -> None:
        """Forget the episode before."""
        self._tracker = Tracker(PERIOD_S, PERIOD_S, VELOCITY_RAD_S, ACCELERATION_RAD_S2, STIFFNESS_RAD_S)
        self._poses, self._has_closed = np.zeros(0), False

    def infer(self, request: Infer) -> tuple[np.ndarray, bool]:
        """(25, 8) rows of joints [rad] and opening [m], and whether that is all."""
        shown = request.observations
        if not self._poses.size:
            self._poses = shown["environment_state"][None].astype(np.float32)
        joints, opening = shown["joint_state"], shown["gripper_width"].reshape(1)
        now_s = np.array([[request.rows_done * PERIOD_S]])
        fed = {"joint_state": joints[None], "gripper_width": opening[None], "time_s": now_s, "poses": self._poses}
        answer = self._model.run(None, {name: each.astype(np.float32) for name, each in fed.items()})[0][0]
        wanted = answer.astype(np.float64)
        rows = self._tracker.follow(wanted[:, :-1], request.rows_done, joints)
        hand = np.where(wanted[:, -1] > HALF_OPEN_M, OPEN_M, 0.0)
        has_let_go = self._has_closed and opening[0] > OPEN_M - 0.01 and (hand > 0.0).all()
        self._has_closed = self._has_closed or hand[0] == 0.0
        is_still = np.ptp(wanted[:, :-1], axis=0).max() < STILL_RAD and len(set(hand)) == 1
        return np.column_stack((rows, hand)), bool(has_let_go or is_still)
