"""Trains policies that answer with chunks of set-points, on exported data sets of verified sessions; writes ONNX.

    python train.py state DATASET… --to weights/state.onnx [--episodes 120] [--steps 6000] [--seed 0]
    python train.py image DATASET… --to weights/image.onnx

Needs the extra `train`, and one core for some minutes. One model takes joints, opening and the pose of the cube as
believed before the first command; the other a picture of the overhead camera instead of the pose.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import torch
from torch import nn

CHUNK = 25  # rows of an answer: one second at the 25 Hz of the data
WIDTH = 256
NOISE = (*(0.02,) * 7, 0.001, *(0.002,) * 2)  # of joints [rad], opening [m], cube [m]: to find back to what was shown
WORTH = (*(10.0,) * 7, 6.0)  # of an error of a joint [1/rad] and of the opening [1/m]
PICTURE = (48, 64)  # height, width
N_POINTS = 16  # of a picture that the network attends to
BATCH, PICTURES = 256, 32
EARLY, EVERY = 12, 3  # frames of an episode in which the arm does not hide the cube yet; one of so many is looked at


class Arm(nn.Module):
    """From joints, opening and where the cube is to a chunk; normalises inside, so that what it takes has units."""

    def __init__(self, seen: torch.Tensor, actions: torch.Tensor) -> None:
        super().__init__()
        for name, values in (("seen", seen), ("action", actions)):
            self.register_buffer(f"{name}_mean", values.mean(0))
            self.register_buffer(f"{name}_std", values.std(0) + 1e-2)
        widths = (seen.shape[1], WIDTH, WIDTH, WIDTH)
        layers = [layer for pair in pairwise(widths) for layer in (nn.Linear(*pair), nn.GELU())]
        self.net = nn.Sequential(*layers, nn.Linear(WIDTH, CHUNK * actions.shape[1]))

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        rows = self.net((seen - self.seen_mean) / self.seen_std).unflatten(-1, (CHUNK, -1))
        return rows * self.action_std + self.action_mean


class StatePolicy(nn.Module):
    """Chunks from joints (n, 7) [rad], opening (n, 1) [m] and pose (n, 7) [m, quaternion w, x, y, z] of the cube."""

    def __init__(self, arm: Arm) -> None:
        super().__init__()
        self.arm = arm

    def forward(self, joint_state: torch.Tensor, gripper_width: torch.Tensor, pose: torch.Tensor) -> torch.Tensor:
        return self.arm(torch.cat((joint_state, gripper_width, describe_pose(pose)), -1))


class Eye(nn.Module):
    """Where the cube is (n, 2) [m], from pictures (n, height, width, 3): from places that it attends to.

    Levine et al. 2016, JMLR 17(39): expected places of softened maps.
    """

    def __init__(self, points: torch.Tensor) -> None:
        super().__init__()
        self.maps = nn.Sequential(
            nn.Conv2d(3, 16, 5, stride=2, padding=2), nn.ReLU(),
            nn.Conv2d(16, 16, 3, padding=1), nn.ReLU(), nn.Conv2d(16, N_POINTS, 3, padding=1),
        )  # fmt: skip
        down, across = (torch.linspace(-1.0, 1.0, side // 2) for side in PICTURE)
        self.register_buffer("places", torch.stack(torch.meshgrid(down, across, indexing="ij"), -1).reshape(-1, 2))
        self.register_buffer("mean", points.mean(0))
        self.register_buffer("std", points.std(0))
        self.read = nn.Linear(2 * N_POINTS, 2)

    def forward(self, picture: torch.Tensor) -> torch.Tensor:
        maps = self.maps(picture.permute(0, 3, 1, 2) / 127.5 - 1.0).flatten(2)
        return self.read((maps.softmax(-1) @ self.places).flatten(1)) * self.std + self.mean


class ImagePolicy(nn.Module):
    """Chunks from joints (n, 7) [rad], opening (n, 1) [m] and a picture (n, height, width, 3) of before the motion."""

    def __init__(self, eye: Eye, arm: Arm) -> None:
        super().__init__()
        self.eye, self.arm = eye, arm

    def forward(self, joint_state: torch.Tensor, gripper_width: torch.Tensor, picture: torch.Tensor) -> torch.Tensor:
        return self.arm(torch.cat((joint_state, gripper_width, self.eye(picture.float())), -1))


def describe_pose(pose: torch.Tensor) -> torch.Tensor:
    """(n, 4) place on the table [m], and the heading of a cube, which looks alike after a quarter of a turn."""
    w, x, y, z = pose[:, 3:].unbind(-1)
    heading = 4.0 * torch.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return torch.cat((pose[:, :2], 0.1 * heading.cos()[:, None], 0.1 * heading.sin()[:, None]), -1)


class Frames:
    """Frames of data sets: state (n, 8), action (n, 8), pose (n, 7), rows (n, CHUNK) of its chunk; the last is held."""

    def __init__(self, folders: list[Path], episodes: int) -> None:
        tables = [pq.read_table(sorted((each / "data").rglob("*.parquet"))) for each in folders]
        names = ("observation.state", "action", "observation.environment_state", "frame_index")
        columns = (
            np.concatenate([np.stack(table[name].to_numpy(zero_copy_only=False)) for table in tables]) for name in names
        )
        state, action, pose, number = columns
        episode = np.cumsum(number == 0) - 1
        kept = episode < episodes
        ends = np.searchsorted(episode, episode, side="right")[kept] - 1
        rows = np.minimum(np.arange(kept.sum())[:, None] + np.arange(CHUNK), ends[:, None])
        self.state, self.action, self.pose = (torch.tensor(each[kept]) for each in (state, action, pose))
        self.rows, self.number, self.episodes = torch.tensor(rows), number[kept], int(episode[kept].max()) + 1
        self._folders = folders

    def read_pictures(self, every: int) -> torch.Tensor:
        """(k, height, width, 3) the overhead picture of every so manieth frame."""
        return torch.tensor(np.stack([each for at, each in enumerate(self._iter_pictures()) if at % every == 0]))

    def _iter_pictures(self) -> Iterator[np.ndarray]:
        import av

        left = len(self.number)
        for film in (each for folder in self._folders for each in sorted(folder.rglob("*overhead/**/*.mp4"))):
            with av.open(film) as container:
                for frame in container.decode(video=0):
                    if (left := left - 1) < 0:
                        return
                    yield frame.reformat(PICTURE[1], PICTURE[0], "rgb24", interpolation="AREA").to_ndarray()


def fit(model: nn.Module, steps: int, rate: float, compute_loss: Callable[[], torch.Tensor]) -> float:
    """AdamW with one cycle of the learning rate; returns the last loss."""
    optimiser = torch.optim.AdamW(model.parameters(), lr=rate, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, total_steps=steps)
    loss = torch.zeros(())
    for step in range(steps):
        loss = compute_loss()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        if step % 500 == 0:
            print(f"step {step}: loss {loss.item():.6f}", flush=True)
    model.eval()
    return loss.item()


def train_arm(frames: Frames, where: torch.Tensor, steps: int) -> tuple[Arm, float]:
    """The arm, from states and from where the cube is (n, k)."""
    seen = torch.cat((frames.state, where), -1)
    arm = Arm(seen, frames.action)
    noise = torch.zeros(seen.shape[1])
    noise[: len(NOISE)] = torch.tensor(NOISE)
    worth = torch.tensor(WORTH)

    def compute_loss() -> torch.Tensor:
        batch = torch.randint(len(seen), (BATCH,))
        noisy = seen[batch] + noise * torch.randn(BATCH, seen.shape[1])
        return ((arm(noisy) - frames.action[frames.rows[batch]]).abs() * worth).mean()

    return arm, fit(arm, steps, 2e-3, compute_loss)


def train_eye(frames: Frames, steps: int) -> tuple[Eye, float]:
    """The eye, from pictures in which the arm has not reached the cube yet."""
    early = torch.tensor(frames.number[::EVERY] < EARLY)
    pictures, points = frames.read_pictures(EVERY)[early], frames.pose[::EVERY][early, :2]
    eye = Eye(points)

    def compute_loss() -> torch.Tensor:
        batch = torch.randint(len(pictures), (PICTURES,))
        noisy = pictures[batch] + 8.0 * torch.randn(PICTURES, 1, 1, 3)  # of their colour
        return (((eye(noisy) - points[batch]) / eye.std) ** 2).mean()

    return eye, fit(eye, steps, 3e-3, compute_loss)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", choices=("state", "image"))
    parser.add_argument("datasets", type=Path, nargs="+")
    parser.add_argument("--to", type=Path, required=True)
    parser.add_argument("--episodes", type=int, default=10**9, help="the first so many")
    parser.add_argument("--steps", type=int, default=6000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    torch.manual_seed(given.seed)
    torch.set_num_threads(1)
    began_s = time.perf_counter()
    frames = Frames(given.datasets, given.episodes)
    made = {"kind": given.kind, "episodes": frames.episodes, "frames": len(frames.state), "seed": given.seed}
    if given.kind == "state":
        arm, made["loss"] = train_arm(frames, describe_pose(frames.pose), given.steps)
        policy: nn.Module = StatePolicy(arm)
        shown = ("pose", frames.pose[:1])
    else:
        filmed = [each for each in given.datasets if (each / "videos").is_dir()]
        eye, made["eye_loss"] = train_eye(Frames(filmed, given.episodes), given.steps // 3)
        arm, made["loss"] = train_arm(frames, frames.pose[:, :2], given.steps)
        policy = ImagePolicy(eye, arm)
        shown = ("picture", torch.zeros((1, *PICTURE, 3), dtype=torch.uint8))
    given.to.parent.mkdir(parents=True, exist_ok=True)
    example = (frames.state[:1, :7], frames.state[:1, 7:], shown[1])
    names = ["joint_state", "gripper_width", shown[0]]
    torch.onnx.export(policy, example, given.to, input_names=names, output_names=["actions"], dynamo=False)
    made |= {"steps": given.steps, "seconds": round(time.perf_counter() - began_s), "bytes": given.to.stat().st_size}
    print(json.dumps(made))


if __name__ == "__main__":
    main()
