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
import re
import tempfile
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from phyagentos.assembly.agent_plane import Agent, MemoryUse
from phyagentos.assembly.paths import OUTCOMES
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.documents.document import read_document
from phyagentos.protocol.sessions.lessons import LESSONS
from phyagentos.protocol.sessions.memory_entries import EntryState
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


def live_in_pairs(seeds: Sequence[int], outcomes: Path) -> None:
    """One life after the other in each of two workspaces: one keeps its memory, the other one's is always empty.

    They stand beside `outcomes`, so that the next lives begin with what these have learned.
    """
    with ExitStack() as stack:
        arms = dict[str, tuple[Workspace, Agent]]()
        for arm, use in (("kept", MemoryUse.LEARN), ("erased", MemoryUse.NONE)):
            root = outcomes.with_suffix(f".{arm}")
            workspace = Workspace.open(root) if root.exists() else Workspace.create(root, Library.open(LIBRARY))
            arms[arm] = workspace, stack.enter_context(open_bench(workspace, SystemClock(), memory_use=use))
        for seed in seeds:
            warned = list_warnings(arms["kept"][0].lessons)
            for arm, (workspace, agent) in arms.items():
                agent.mission.run(LIBRARY / "goal_graphs" / "live.yaml", seed=seed, goal=f"life-{seed}")
                life = read_lives(workspace.root / OUTCOMES)[seed]
                with outcomes.open("a", encoding="utf-8") as file:
                    file.write(json.dumps({**life, "arm": arm, "warned": warned}) + "\n")


def list_warnings(lessons: Path) -> list[str]:
    """What LESSONS.md warns of: causes of earlier deaths."""
    if not lessons.exists():
        return []
    entries = read_document(lessons.read_text(encoding="utf-8"), LESSONS, str(lessons)).blocks.values()
    active = [each.condition for each in entries if each.state is EntryState.ACTIVE]
    return sorted({found[1] for text in active if (found := re.search(r"lost_to_(\w+)", text))})


def compare(file: Path) -> dict[str, float]:
    """Of each seed the life with memory kept beside that with memory erased, and the sign test of their differences.

    Deaths count within the steps that both lives had.
    """
    lines = [*map(json.loads, file.read_text(encoding="utf-8").splitlines())]
    arms = [{line["seed"]: line for line in lines if line["arm"] == arm} for arm in ("kept", "erased")]
    pairs = [(arms[0][seed], arms[1][seed]) for seed in arms[0] if seed in arms[1]]
    longer = [kept["steps"] - erased["steps"] for kept, erased in pairs]
    died = [
        [pair[index]["lost_to"] in pair[0]["warned"] and sign * more <= 0 for index, sign in ((0, 1), (1, -1))]
        for pair, more in zip(pairs, longer, strict=True)
    ]
    figures: dict[str, float] = {"pairs": len(pairs)}
    for index, arm in enumerate(("kept", "erased")):
        figures[f"{arm}_days_mean"] = round(sum(pair[index]["steps"] for pair in pairs) / len(pairs) / DAY_STEPS, 2)
        figures[f"{arm}_deaths_warned_of"] = sum(each[index] for each in died)
        figures[f"{arm}_score"] = round(compute_score([pair[index]["completed"] for pair in pairs]), 1)
    figures["deaths_p"] = compute_sign_test(died.count([False, True]), died.count([True, False]))
    figures["days_p"] = compute_sign_test(sum(each > 0 for each in longer), sum(each < 0 for each in longer))
    return figures


def compute_sign_test(better: int, worse: int) -> float:
    """The chance of so many out of all that differ, or more, if neither were likelier (McNemar 1947, exact)."""
    from scipy.stats import binomtest  # half a second to load, for comparisons alone

    return round(float(binomtest(better, better + worse, alternative="greater").pvalue), 4) if better + worse else 1.0


def plot(file: Path, to: Path) -> None:
    """Days survived in one life after the other, memory kept and erased."""
    from matplotlib import pyplot  # slow to load, and of no use to other runs

    figure, axes = pyplot.subplots(figsize=(7.0, 3.5), layout="constrained")
    lines = [*map(json.loads, file.read_text(encoding="utf-8").splitlines())]
    for arm, marker in (("kept", "o"), ("erased", "x")):
        days = [line["steps"] / DAY_STEPS for line in lines if line["arm"] == arm]
        means = [sum(days[: n + 1]) / (n + 1) for n in range(len(days))]
        (line,) = axes.plot(range(1, len(days) + 1), means, label=f"memory {arm}: mean so far")
        axes.plot(range(1, len(days) + 1), days, marker, alpha=0.5, color=line.get_color())
    axes.set(xlabel="life", ylabel="days survived")
    axes.legend()
    figure.savefig(to)


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
    parser.add_argument("--paired", action="store_true", help="each seed twice: memory kept, and erased")
    parser.add_argument("--plot", type=Path, help="days survived per life, of paired lives")
    given = parser.parse_args()
    if given.paired:
        live_in_pairs(given.seeds, given.outcomes)
        if given.plot:
            plot(given.outcomes, given.plot)
        print(json.dumps({"figures": compare(given.outcomes)}))
        return
    if given.seeds:
        live(given.seeds, given.outcomes)
    print(json.dumps({"figures": sum_up(read_lives(given.outcomes))}))


if __name__ == "__main__":
    main()
