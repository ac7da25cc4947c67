"""Trains a policy that answers with chunks of actions, from the states of an exported data set, and writes it as ONNX.

    python train.py DATASET weights/state.onnx [--episodes 120] [--steps 3000] [--seed 0]

Needs the extra `train`. Input: joints [rad], opening [m] and the cube's position [m] as believed before the first
command. Output: CHUNK set-points of the arm and the hand at the rate of the data.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import torch
from torch import nn

CHUNK = 50
NOISE = 0.01  # of the normalised input: a policy must find back to where it was shown the way
WIDTH = 256


class StatePolicy(nn.Module):
    """A perceptron with its normalisation inside: what it takes and gives has units."""

    def __init__(self, inputs: np.ndarray, actions: np.ndarray) -> None:
        super().__init__()
        for name, values in (("input", inputs), ("action", actions)):
            self.register_buffer(f"{name}_mean", torch.tensor(values.mean(0), dtype=torch.float32))
            self.register_buffer(f"{name}_std", torch.tensor(values.std(0) + 1e-3, dtype=torch.float32))
        self.net = nn.Sequential(
            nn.Linear(inputs.shape[1], WIDTH), nn.GELU(), nn.Linear(WIDTH, WIDTH), nn.GELU(),
            nn.Linear(WIDTH, WIDTH), nn.GELU(), nn.Linear(WIDTH, CHUNK * actions.shape[1]),
        )  # fmt: skip

    def forward(self, observed: torch.Tensor) -> torch.Tensor:
        rows = self.net((observed - self.input_mean) / self.input_std).unflatten(-1, (CHUNK, -1))
        return rows * self.action_std + self.action_mean


def read_examples(folder: Path, episodes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Inputs (n, 11), actions (n, 8), and for each frame the rows of its chunk (n, CHUNK); the last one is held."""
    table = pq.read_table(sorted((folder / "data").rglob("*.parquet")))
    columns = {name: np.stack(table[name].to_numpy(zero_copy_only=False)) for name in ("observation.state", "action")}
    world = np.stack(table["observation.environment_state"].to_numpy(zero_copy_only=False))[:, :3]
    episode = table["episode_index"].to_numpy()
    chosen = np.flatnonzero(episode < episodes)
    ends = np.searchsorted(episode, episode, side="right") - 1
    rows = np.minimum(chosen[:, None] + np.arange(CHUNK), ends[chosen, None])
    return np.hstack((columns["observation.state"], world))[chosen], columns["action"], rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("to", type=Path)
    parser.add_argument("--episodes", type=int, default=10**9, help="the first so many")
    parser.add_argument("--steps", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    torch.manual_seed(given.seed)
    inputs, actions, rows = read_examples(given.dataset, given.episodes)
    policy = StatePolicy(inputs, actions)
    x, y, index = torch.tensor(inputs), torch.tensor(actions), torch.tensor(rows)
    optimiser = torch.optim.AdamW(policy.parameters(), lr=1e-3, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 2e-3, total_steps=given.steps)
    began_s = time.perf_counter()
    loss = torch.zeros(())
    for step in range(given.steps):
        batch = torch.randint(len(x), (256,))
        noisy = x[batch] + NOISE * policy.input_std * torch.randn(len(batch), x.shape[1])
        loss = (((policy(noisy) - y[index[batch]]) / policy.action_std) ** 2).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        if step % 500 == 0:
            print(f"step {step}: loss {loss.item():.5f}", flush=True)
    policy.eval()
    given.to.parent.mkdir(parents=True, exist_ok=True)
    torch.onnx.export(policy, (x[:1],), given.to, input_names=["observed"], output_names=["rows"], dynamo=False)
    made = {"episodes": min(given.episodes, int(1e6)), "frames": len(x), "steps": given.steps, "seed": given.seed}
    made |= {"loss": round(loss.item(), 6), "seconds": round(time.perf_counter() - began_s, 1)}
    print(json.dumps(made | {"bytes": given.to.stat().st_size}))


if __name__ == "__main__":
    main()
