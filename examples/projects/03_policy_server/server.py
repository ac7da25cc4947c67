"""A policy server: imitates one demonstration, row by row. Whether that helps is for the verifier to say.

    python server.py EVIDENCE_FOLDER [--endpoint tcp://127.0.0.1:5555]

The demonstration is the trajectory of a recorded session. Where the scene stands as it stood then, following it meets
the goal; where it stands otherwise the hand closes on air, and this policy says that it is done all the same.
"""

import argparse
from pathlib import Path

import numpy as np

from phyagentos.protocol.capabilities.policy_descriptors import PolicyDescriptor
from phyagentos.protocol.capabilities.skill_runtimes import read_skill
from phyagentos.runtime.policies.policy_server import serve_policy
from phyagentos.runtime.policies.wire import Infer, Start

CHUNK = 25  # rows: half a second at 50 Hz


class Imitation:
    """Follows a demonstration.

    Args:
        rows: (k, n_joints + 1) joint positions [rad] and opening [m], one per control period.
    """

    def __init__(self, rows: np.ndarray) -> None:
        self._rows = rows

    def start(self, request: Start) -> None:
        print(f"{request.session}: {request.instruction}", flush=True)

    def infer(self, request: Infer) -> tuple[np.ndarray, bool]:
        chunk = self._rows[request.rows_done : request.rows_done + CHUNK]
        return chunk, request.rows_done + len(chunk) >= len(self._rows)


def read_demonstration(bundle: Path) -> np.ndarray:
    """What was commanded in a recorded session."""
    with np.load(bundle / "trajectory.npz") as recorded:
        return np.column_stack((recorded["q_commanded"], recorded["gripper_commanded_m"]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bundle", type=Path, help="evidence folder of the demonstration")
    parser.add_argument("--endpoint", default="tcp://127.0.0.1:5555")
    given = parser.parse_args()
    skill, _ = read_skill(Path(__file__).parent / "skills" / "imitate" / "SKILL.md")
    assert skill.policy is not None
    descriptor = PolicyDescriptor.model_validate(skill.policy.model_dump() | {"endpoint": given.endpoint})
    policy = Imitation(read_demonstration(given.bundle))
    serve_policy(policy, descriptor, lambda endpoint: print(f"serving at {endpoint}", flush=True))


if __name__ == "__main__":
    main()
