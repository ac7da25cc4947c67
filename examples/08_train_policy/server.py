"""Serves the trained policy: ONNX behind `phyagentos.runtime.policies.server`.

    python server.py weights/state.onnx
"""

import argparse
from pathlib import Path

import numpy as np
import onnxruntime

from phyagentos.protocol.capabilities.policy_descriptors import PolicyDescriptor
from phyagentos.protocol.capabilities.skill_runtimes import read_skill
from phyagentos.runtime.policies.server import serve_policy
from phyagentos.runtime.policies.wire import Infer, Start

STILL_RAD = 0.03  # a chunk that goes nowhere is the last one


class StatePolicy:
    """Asks the model once a chunk."""

    def __init__(self, model: Path) -> None:
        self._model = onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])
        self._at = np.zeros(3)

    def start(self, request: Start) -> None:
        self._at = np.array(request.parameters["at"], dtype=np.float64)

    def infer(self, request: Infer) -> tuple[np.ndarray, bool]:
        joints = request.observations["joint_state"]
        seen = np.concatenate((joints, request.observations["gripper_width"].reshape(1), self._at))
        (rows,) = self._model.run(None, {"observed": seen[None].astype(np.float32)})
        rows = rows[0].astype(np.float64)
        rows[:, -1] = rows[:, -1].clip(0.0, 0.08)
        return rows, bool(np.abs(rows[:, :-1] - joints).max() < STILL_RAD)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    given = parser.parse_args()
    skill, _ = read_skill(Path(__file__).parent / "skills" / "pick_by_state" / "SKILL.md")
    assert skill.policy is not None
    descriptor = PolicyDescriptor.model_validate(skill.policy.model_dump())
    serve_policy(StatePolicy(given.model), descriptor, lambda endpoint: print(f"serving at {endpoint}", flush=True))


if __name__ == "__main__":
    main()
