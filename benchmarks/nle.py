"""Games of NetHack by BALROG's settings: `python -m benchmarks.nle --outcomes FILE`.

It needs `make build/nle/.installed`, and Python 3.11 there.

Each seed is one game: a goal on the target `adventurer`, by the ordinary path of `paos run`. Settings are those of
BALROG's configuration (`kits/nle/nle_body/game.py`); it plays 5 games with seeds by chance, here they are given.
Progress is BALROG's: of the depth and the experience level that were reached the greater share of people who won from
there (`nle_parts/progress.yaml`). Only this script knows it.

Given to the agent: the screen's symbols, as BALROG's agents have them as text; a memory of what was seen; skills and
rules that people wrote: which monsters are not struck, what can be eaten, when a prayer helps, that one can dig. Not
given: the map beyond what was seen, what unidentified objects are, saved games, a second try.
"""

import argparse
import json
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.crafter import read_lives
from benchmarks.runner import show
from phyagentos.assembly.paths import OUTCOMES
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace

LIBRARY = Path(__file__).parent / "nle_parts" / "library"
PROGRESS: Mapping[str, Sequence[float]] = yaml.safe_load((LIBRARY.parent / "progress.yaml").read_text(encoding="utf-8"))
PUBLISHED = (
    ("Grok-4", "text", 1.76, 0.8), ("Gemini-2.5-Pro-Exp-03-25", "text", 1.69, 0.2), ("Grok-3-beta", "text", 1.64, 0.4),
    ("Gemini-2.5-Pro-Exp-03-25", "text and pictures", 1.64, 0.4), ("DeepSeek-R1", "text", 1.38, 0.5),
    ("Claude-3.5-Haiku", "text", 1.16, 0.4), ("Claude-3.5-Sonnet", "text and pictures", 1.16, 0.4),
    ("Gemini-2.5-Flash", "text", 0.79, 0.4), ("Claude-3.5-Sonnet", "text", 0.58, 0.5), ("GPT-4o", "text", 0.37, 0.4),
)  # fmt: skip
"""Mean and error of BALROG's leaderboard (github.com/balrog-ai/experiments, index.html, 989931c5 of 2025-07-23)."""
NO_COMPARISON = (
    "no comparison: those are language models without skills or rules of the game, 5 games each, one action a request"
)
SAMPLES, SPREAD = 10_000, (2.5, 97.5)


def measure_progress(game: Mapping[str, Any]) -> float:
    """Progress of a game [%]."""
    return max(PROGRESS[name][min(game[name], len(PROGRESS[name])) - 1] for name in ("depth", "level"))


def play(seeds: Sequence[int], outcomes: Path) -> None:
    """One game after the other, in one workspace; how each stands is appended to `outcomes`."""
    with tempfile.TemporaryDirectory() as folder:
        workspace = Workspace.create(Path(folder) / "w", Library.open(LIBRARY))
        with open_bench(workspace, SystemClock()) as agent:
            for seed in seeds:
                agent.mission.run(LIBRARY / "goal_graphs" / "dive.yaml", seed=seed, goal=f"game-{seed}")
                with outcomes.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(read_lives(workspace.root / OUTCOMES)[seed]) + "\n")


def sum_up(games: Mapping[int, Mapping[str, Any]]) -> dict[str, float]:
    """Mean progress with its standard error, as the leaderboard has it, and its interval of 95 % by the bootstrap."""
    progress = np.array([measure_progress(each) for each in games.values()])
    means = np.random.default_rng(0).choice(progress, (SAMPLES, len(progress))).mean(axis=1)
    low, high = np.percentile(means, SPREAD)
    figures = {
        "games": len(progress),
        "progress_mean": progress.mean(),
        "progress_error": progress.std(ddof=1) / len(progress) ** 0.5 if len(progress) > 1 else 0.0,
        "progress_low": low,
        "progress_high": high,
        "depth_mean": np.mean([each["depth"] for each in games.values()]),
        "level_mean": np.mean([each["level"] for each in games.values()]),
        "steps_mean": np.mean([each["steps"] for each in games.values()]),
        "unfinished": sum(not each["is_over"] for each in games.values()),
    }
    return {name: round(float(figure), 2) for name, figure in figures.items()}


def main() -> None:
    """Play, and print the games, BALROG's rows and the figures."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--seeds", type=int, nargs="*", default=list(range(1, 11)))
    parser.add_argument("--outcomes", type=Path, required=True, help="JSON lines, appended to; all games in it count")
    given = parser.parse_args()
    if given.seeds:
        play(given.seeds, given.outcomes)
    games = read_lives(given.outcomes)
    columns = ("depth", "level", "turns", "steps", "end")
    rows = [(seed, f"{measure_progress(game):.2f}", *(game[each] for each in columns)) for seed, game in games.items()]
    show("NetHack by BALROG's settings", ("seed", "progress %", *columns), rows)
    figures = sum_up(games)
    found = (f"{figures['progress_mean']:.2f}", figures["progress_error"])
    ours = ("this agent", "symbols of the screen, skills and rules", *found)
    show("Mean progress", ("agent", "given", "%", "standard error"), [ours, *PUBLISHED])
    print("BALROG's leaderboard of 2025-07-23;", NO_COMPARISON)
    print(json.dumps({"figures": figures, "ends": Counter(game["end"] for game in games.values())}))


if __name__ == "__main__":
    main()
