"""Trains a policy that puts one object into or onto another, on exported data sets of verified sessions; writes ONNX.

    python -m benchmarks.libero_parts.policy.train_place DATASET… --to place.onnx [--steps 8000] [--seed 0]

Needs the extra `train`. Data sets are those of `paos export lerobot WORKSPACE… --skill pick_and_place --entities
object,destination`, and of `stack` with `object,support`. The network and how it is fitted are those of
examples/projects/10_train_policy.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import torch
from torch import Tensor, nn

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "examples" / "projects" / "10_train_policy"))
from train import BATCH, WORTH, Arm, Frames, fit

RATE_HZ = 20.0
NOISE = torch.tensor((*(0.02,) * 7, 0.001, 0.3, *(*(0.002,) * 3, *(0.02,) * 6) * 2))  # joints, opening, time, each pose
INPUTS = ("joint_state", "gripper_width", "time_s", "poses")


class PlacePolicy(nn.Module):
    """Chunks from joints (n, 7) [rad], opening (n, 1) [m], time since the first command (n, 1) [s] and poses (n, 2, 7).

    Of a pose: m, quaternion w, x, y, z.
    """

    def __init__(self, arm: Arm) -> None:
        super().__init__()
        self.arm = arm

    def forward(self, joint_state: Tensor, gripper_width: Tensor, time_s: Tensor, poses: Tensor) -> Tensor:
        """(n, CHUNK, 8) rows of joints [rad] and opening [m]."""
        return self.arm(torch.cat((joint_state, gripper_width, time_s, describe_poses(poses)), -1))


def describe_poses(poses: Tensor) -> Tensor:
    """(n, 18) of each of both its place [m] and two columns of its rotation."""
    w, x, y, z = poses[..., 3:].unbind(-1)
    turned = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))
    across = (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x))
    return torch.cat((poses[..., :3], torch.stack((*turned, *across), -1)), -1).flatten(1)


def train_arm(frames: Frames, steps: int) -> tuple[Arm, float]:
    """The arm, and its last loss."""
    time_s = torch.tensor(frames.number, dtype=torch.float32)[:, None] / RATE_HZ
    seen = torch.cat((frames.state, time_s, describe_poses(frames.pose.unflatten(-1, (2, 7)))), -1)
    arm, worth = Arm(seen, frames.action), torch.tensor(WORTH)

    def compute_loss() -> Tensor:
        batch = torch.randint(len(seen), (BATCH,))
        noisy = seen[batch] + NOISE * torch.randn(BATCH, seen.shape[1])
        return ((arm(noisy) - frames.action[frames.rows[batch]]).abs() * worth).mean()

    return arm, fit(arm, steps, 2e-3, compute_loss)


def main() -> None:
    """Train, write, and say what was made of what."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", type=Path, nargs="+")
    parser.add_argument("--to", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=8000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    torch.manual_seed(given.seed)
    torch.set_num_threads(1)
    began_s = time.perf_counter()
    frames = Frames(given.datasets, 10**9)
    arm, loss = train_arm(frames, given.steps)
    shown = (frames.state[:1, :7], frames.state[:1, 7:], torch.zeros(1, 1), frames.pose[:1].unflatten(-1, (2, 7)))
    torch.onnx.export(
        PlacePolicy(arm), shown, given.to, input_names=list(INPUTS), output_names=["actions"], dynamo=False
    )
    made = {"episodes": frames.episodes, "frames": len(frames.state), "seed": given.seed, "steps": given.steps}
    made |= {"loss": loss, "seconds": round(time.perf_counter() - began_s), "bytes": given.to.stat().st_size}
    print(json.dumps(made))


if __name__ == "__main__":
    main()
