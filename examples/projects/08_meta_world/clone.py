"""Behaviour cloning of Meta-World's experts by small networks, in numpy: one a task, from demonstrations made here.

    python examples/projects/08_meta_world/clone.py clones.npz --tasks drawer-close-v3 push-v3 pick-place-v3

In a demonstration the hand is disturbed at every step, and what the expert would do undisturbed is learnt. Seeds begin
at 1000: no evaluation sees them. `experts.py --clones clones.npz` serves the networks beside the experts.
"""

import argparse
import json
import time
import warnings
from pathlib import Path

import gymnasium
import metaworld  # noqa: F401 - registers its environments
import numpy as np
from metaworld.policies import ENV_POLICY_MAP
from numpy.typing import NDArray

Array = NDArray[np.float64]
FIRST_SEED, STEPS, NOISE = 1000, 300, 0.6
HIDDEN, BATCH, RATE, UPDATES = 128, 256, 1e-3, 5000
NAMES = ("w1", "b1", "w2", "b2", "w3", "b3")


def describe(seen: Array) -> Array:
    """Features (..., 26) of observations (..., 39): hand, fingers, object, goal, and how they lie to each other."""
    hand, fingers, item, goal = seen[..., :3], seen[..., 3:4], seen[..., 4:11], seen[..., 36:39]
    moved = (seen[..., :3] - seen[..., 18:21], seen[..., 4:7] - seen[..., 22:25])
    apart = (item[..., :3] - hand, goal - hand, goal - item[..., :3])
    far = np.linalg.norm(apart[0], axis=-1, keepdims=True)
    return np.concatenate((hand, fingers, item[..., :3], goal, *apart, *(10.0 * each for each in moved), far), axis=-1)


def apply(net: dict[str, Array], seen: Array) -> Array:
    """Actions (..., 4) of a network."""
    x = (describe(seen) - net["mean"]) / net["std"]
    x = np.maximum(x @ net["w1"] + net["b1"], 0.0)
    x = np.maximum(x @ net["w2"] + net["b2"], 0.0)
    return np.asarray(x @ net["w3"] + net["b3"])


def demonstrate(task: str, episodes: int) -> tuple[Array, Array]:
    """Observations (n, 39) and the expert's actions (n, 4), cut to what the environment takes."""
    seen, done = list[Array](), list[Array]()
    for seed in range(FIRST_SEED, FIRST_SEED + episodes):
        env = gymnasium.make("Meta-World/MT1", env_name=task, seed=seed, disable_env_checker=True)
        observed, _ = env.reset(seed=seed)
        expert, chance, left = ENV_POLICY_MAP[task](), np.random.default_rng(seed), STEPS
        while left:
            action = np.clip(expert.get_action(observed.copy()), -1.0, 1.0).astype(np.float64)
            seen.append(observed)
            done.append(action)
            moved = np.clip(action + NOISE * chance.normal(size=4) * (1.0, 1.0, 1.0, 0.0), -1.0, 1.0)
            observed, *_, info = env.step(moved.astype(np.float32))
            left = min(left - 1, 20) if info["success"] else left - 1
        env.close()
    return np.array(seen), np.array(done)


def train(seen: Array, done: Array) -> tuple[dict[str, Array], float]:
    """A network and its mean squared error over the last updates, by Adam."""
    chance, x = np.random.default_rng(0), describe(seen)
    net = {"mean": x.mean(0), "std": x.std(0) + 1e-3}
    for layer, (n, m) in enumerate(((x.shape[1], HIDDEN), (HIDDEN, HIDDEN), (HIDDEN, 4)), start=1):
        net |= {f"w{layer}": chance.normal(size=(n, m)) * np.sqrt(2.0 / n), f"b{layer}": np.zeros(m)}
    x = (x - net["mean"]) / net["std"]
    first, second = ({name: np.zeros_like(net[name]) for name in NAMES} for _ in range(2))
    losses = list[float]()
    for update in range(1, UPDATES + 1):
        at = chance.integers(len(x), size=BATCH)
        a = np.maximum(x[at] @ net["w1"] + net["b1"], 0.0)
        b = np.maximum(a @ net["w2"] + net["b2"], 0.0)
        off = b @ net["w3"] + net["b3"] - done[at]
        losses.append(float((off**2).mean()))
        g3 = 2.0 * off / off.size
        g2 = (g3 @ net["w3"].T) * (b > 0.0)
        g1 = (g2 @ net["w2"].T) * (a > 0.0)
        slopes = (x[at].T @ g1, g1.sum(0), a.T @ g2, g2.sum(0), b.T @ g3, g3.sum(0))
        rate = RATE * (1.0 - update / (UPDATES + 1)) * np.sqrt(1.0 - 0.999**update) / (1.0 - 0.9**update)
        for name, slope in zip(NAMES, slopes, strict=True):
            first[name] = 0.9 * first[name] + 0.1 * slope
            second[name] = 0.999 * second[name] + 0.001 * slope**2
            net[name] -= rate * first[name] / (np.sqrt(second[name]) + 1e-8)
    return net, float(np.mean(losses[-500:]))


def main() -> None:
    """Demonstrate, train, save."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights", type=Path)
    parser.add_argument("--tasks", nargs="+", required=True)
    parser.add_argument("--episodes", type=int, default=40)
    given = parser.parse_args()
    warnings.filterwarnings("ignore", module="metaworld")
    arrays: dict[str, Array] = {}
    for task in given.tasks:
        began_s = time.process_time()
        seen, done = demonstrate(task, given.episodes)
        net, loss = train(seen, done)
        arrays |= {f"{task}/{name}": each.astype(np.float32) for name, each in net.items()}
        told = {"task": task, "rows": len(seen), "loss": round(loss, 5), "cpu_s": round(time.process_time() - began_s)}
        print(json.dumps(told), flush=True)
    np.savez_compressed(given.weights, **arrays)  # type: ignore[arg-type]


if __name__ == "__main__":
    main()
