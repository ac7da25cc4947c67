"""Lives in Crafter: `python -m benchmarks.crafter --seeds 1 2 3 --outcomes FILE`.

Each seed is one life: a goal on the target `survivor`, by the ordinary path of `paos run`. What is counted is the
environment's own achievements, which only this script reads. The same seed gives the same life. The score is
Crafter's: over the percentages p of lives that unlocked each of the 22 achievements, exp(mean(ln(1 + p))) - 1.

Given to the agent: the local view of nine by seven cells as symbols, without the noise of the night; what it saw
before; the recipes. Published scores were given other inputs, mostly pixels: random 1.6, DreamerV3 14.5 (a million
steps of training), SPRING with GPT-4 27.3 (the paper of the game and a description of the view), human 50.5.
"""

import argparse
import json
import math
import tempfile
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from phyagentos.assembly.paths import OUTCOMES
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace

LIBRARY = Path(__file__).parent / "crafter_parts" / "library"
ACHIEVEMENTS = (
    "collect_coal", "collect_diamond", "collect_drink", "collect_iron", "collect_sapling", "collect_stone",
    "collect_wood", "defeat_skeleton", "defeat_zombie", "eat_cow", "eat_plant", "make_iron_pickaxe", "make_iron_sword",
    "make_stone_pickaxe", "make_stone_sword", "make_wood_pickaxe", "make_wood_sword", "place_furnace", "place_plant",
    "place_stone", "place_table", "wake_up",
)  # fmt: skip
DAY_STEPS = 300


def compute_score(lives: Sequence[Iterable[str]]) -> float:
    """Crafter's score [%] of lives, each by the achievements that it unlocked (Hafner, 2021, arXiv:2109.06780)."""
    counts = Counter(name for life in lives for name in {*life})
    logs = [math.log(1.0 + 100.0 * counts[name] / len(lives)) for name in ACHIEVEMENTS]
    return math.exp(sum(logs) / len(logs)) - 1.0


def read_lives(file: Path) -> dict[int, Mapping[str, Any]]:
    """The last line of each seed: how its life stood when its last session ended."""
    lines = map(json.loads, file.read_text(encoding="utf-8").splitlines())
    return {line["seed"]: line for line in lines}


def live(seeds: Sequence[int], outcomes: Path) -> None:
    """One life after the other, in one workspace; what the game says of each is appended to `outcomes`."""
    with tempfile.TemporaryDirectory() as folder:
        workspace = Workspace.create(Path(folder) / "w", Library.open(LIBRARY))
        with open_bench(workspace, SystemClock()) as agent:
            for seed in seeds:
                agent.mission.run(LIBRARY / "goal_graphs" / "live.yaml", seed=seed, goal=f"life-{seed}")
        with outcomes.open("ab") as file:
            file.write((workspace.root / OUTCOMES).read_bytes())


def sum_up(lives: Mapping[int, Mapping[str, Any]]) -> dict[str, float]:
    """The figures of these lives; shares are of lives."""
    unlocked = Counter(name for life in lives.values() for name in life["completed"])
    deaths = Counter(life["cause"].replace(" ", "_") for life in lives.values() if life["is_dead"])
    return {
        "lives": len(lives),
        "score": round(compute_score([life["completed"] for life in lives.values()]), 1),
        "achievements_mean": round(sum(unlocked.values()) / len(lives), 2),
        "days_mean": round(sum(life["steps"] for life in lives.values()) / len(lives) / DAY_STEPS, 2),
        **{f"share_{name}": round(unlocked[name] / len(lives), 3) for name in ACHIEVEMENTS},
        **{f"died_of_{cause}": n for cause, n in sorted(deaths.items())},
    }


def main() -> None:
    """Live, and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--seeds", type=int, nargs="*", default=list(range(1, 11)))
    parser.add_argument("--outcomes", type=Path, required=True, help="JSON lines, appended to; all lives in it count")
    given = parser.parse_args()
    if given.seeds:
        live(given.seeds, given.outcomes)
    print(json.dumps({"figures": sum_up(read_lives(given.outcomes))}))


if __name__ == "__main__":
    main()
