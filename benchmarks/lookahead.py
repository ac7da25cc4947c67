"""What look-ahead is worth on hard scenes, and what it costs: the same goals and seeds, without it and with it.

    python benchmarks/lookahead.py --seeds 12

Three scenes: a load that slips off when it is carried fast (`waiter`), the same near the limit of the reach
(`far_waiter`), and a cluttered table beside a board that tips when a block is put on its end (`seesaw`). What a thing
weighs and how it slips is drawn by the seed from spans that the scene declares; look-ahead knows the spans, never the
draw. Both runs go through agent, journal, watchdog, worker, planner and world, as `paos run` does, and see what the
cameras see (`--sense truth` for comparison). A first attempt is the first session that moved a motor; whether it met
its objective is read from the recorded state of the simulator, with MuJoCo and numpy alone. The cost of a forecast is
its wall time, other ways of doing it included.
"""

import argparse
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import yaml
from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest
from tabletop import ROOT

from phyagentos.assembly.paths import open_project
from phyagentos.bench.report import Ask, Rate, Spread, format_outcome
from phyagentos.bench.scorers.simulator_state import is_in_tray
from phyagentos.bench.suite import Episode, open_bench, run_suite
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.lookahead import LookaheadResult, read_lookahead
from phyagentos.protocol.settings.perception import Sensing

GRAPHS = Path(__file__).with_name("lookahead_parts")
COIN_RADIUS_M, COIN_HALF_M, COASTER_M = 0.015, 0.008, (0.03, 0.03, 0.02)
BLOCK_HALF_M, BOARD_M = 0.02, (0.14, 0.05, 0.006)
GAP_M = 0.006  # between what rests on each other, contact softness and a small tilt included
LEVEL_COS = 0.985  # ten degrees
TABLE_WIDTH = 150  # a row on one line
ASKED = {
    "gain": Ask(0.2, at_least=True),
    "mcnemar_p": Ask(0.05, at_least=False),
    "false_successes": Ask(0.0, at_least=False),
    "cost_ms_median": Ask(3000.0, at_least=False),
}


def is_served(folder: Path) -> bool:
    """Whether the coaster lies in the tray, and the coin on the coaster."""
    rest_m = COASTER_M[2] + COIN_HALF_M
    return is_in_tray(folder, "coaster", "tray") and rests_on(folder, "coin", "coaster", COASTER_M, rest_m)


def is_balanced(folder: Path) -> bool:
    """Whether the block lies on the board, and the board is level."""
    return rests_on(folder, "red_block", "board", BOARD_M, BOARD_M[2] + BLOCK_HALF_M)


def rests_on(folder: Path, load: str, carrier: str, half_m: Sequence[float], height_m: float) -> bool:
    """Whether the middle of `load` stands `height_m` [m] above that of a level box of these half extents [m]."""
    model = mujoco.MjModel.from_binary_path(str(folder / "scene.mjb"))
    data = mujoco.MjData(model)
    with np.load(folder / "terminal.npz") as terminal:
        data.qpos[:] = terminal["qpos"]
    mujoco.mj_kinematics(model, data)
    rotation = data.body(carrier).xmat.reshape(3, 3)
    place = rotation.T @ (data.body(load).xpos - data.body(carrier).xpos)
    is_over = abs(place[0]) <= half_m[0] and abs(place[1]) <= half_m[1]
    return bool(rotation[2, 2] > LEVEL_COS and is_over and abs(place[2] - height_m) <= GAP_M)


SCENES: dict[str, tuple[str, Callable[[Path], bool]]] = {
    "waiter": ("serve", is_served),
    "far_waiter": ("serve_far", is_served),
    "seesaw": ("balance", is_balanced),
}


@dataclass(frozen=True, slots=True)
class Try:
    """One goal.

    Attributes:
        first: Whether the first attempt that moved a motor met the objective.
        is_false: Whether its verdict was success and the recorded world says no.
        revisions: Sessions that look-ahead refused.
        forecasts: Of every session of the goal.
    """

    first: bool
    is_false: bool
    revisions: int
    forecasts: tuple[LookaheadResult, ...]


def run_arm(base: Path, scene: str, seeds: Sequence[int], ahead: bool, sense: str, console: Console) -> list[Try]:
    """One scene with one warm runtime plane, with look-ahead or without."""
    name, judge = SCENES[scene]
    arm = "with" if ahead else "without"
    folder = base / f"{scene}-{arm}"
    workspace = open_project(folder, ROOT)
    graph = workspace.root / f"{name}.yaml"
    graph.write_text(write_graph(GRAPHS / f"{name}.yaml", ahead), encoding="utf-8")
    tries = []
    with open_bench(workspace, SystemClock(), sense=Sensing(sense)) as agent:
        for episode in run_suite(agent, workspace, graph, seeds):
            tries.append(count(episode, judge))
            met = "met" if tries[-1].first else "missed"
            console.print(f"{scene} {arm} look-ahead, seed {episode.seed}: {met}", style="dim")
    return tries


def write_graph(path: Path, ahead: bool) -> str:
    """The shipped graph, its look-ahead taken out where none is wanted."""
    graph = yaml.safe_load(path.read_text(encoding="utf-8"))
    graph["defaults"]["max_replans"] = 0  # a refusal spends none, and what a second attempt comes to is not asked
    if not ahead:
        del graph["defaults"]["lookahead"]
    return yaml.safe_dump(graph, sort_keys=False)


def count(episode: Episode, judge: Callable[[Path], bool]) -> Try:
    """What came of one goal."""
    folders = [(each, episode.workspace.evidence_of(each.id)) for each in episode.report.sessions]
    moved = [(each, folder) for each, folder in folders if each.ticks and (folder / "terminal.npz").exists()]
    found = [read_lookahead(folder) for _, folder in folders]
    met = bool(moved) and judge(moved[0][1])
    return Try(
        first=met,
        is_false=bool(moved) and moved[0][0].verdict == "success" and not met,
        revisions=sum(each.state == "rejected" for each, _ in folders),
        forecasts=tuple(each for each in found if each is not None),
    )


def count_discordant(before: Sequence[bool], after: Sequence[bool]) -> tuple[int, int]:
    """Pairs that only the second arm met, and pairs that only the first one did."""
    pairs = list(zip(before, after, strict=True))
    return sum(b and not a for a, b in pairs), sum(a and not b for a, b in pairs)


def compute_mcnemar(before: Sequence[bool], after: Sequence[bool]) -> float:
    """Two-sided exact p of McNemar's test on paired outcomes (McNemar 1947, doi:10.1007/BF02295996)."""
    won, lost = count_discordant(before, after)
    return float(binomtest(won, won + lost).pvalue) if won + lost else 1.0


def show(console: Console, without: dict[str, list[Try]], ahead: dict[str, list[Try]]) -> None:
    """One row per scene, and one for all."""
    table = Table(title="first attempts that met their objective, by the recorded world")
    for column in ("scene", "without", "with", "won, lost", "p (McNemar)", "refused", "rollouts", "ms: median, p95"):
        table.add_column(column)
    rows = {scene: (without[scene], ahead[scene]) for scene in without}
    every = tuple([each for tries in arm.values() for each in tries] for arm in (without, ahead))
    for scene, (plain, careful) in {**rows, "all": (every[0], every[1])}.items():
        before, after = [each.first for each in plain], [each.first for each in careful]
        forecasts = [result for each in careful for result in each.forecasts]
        cost = Spread.of([result.cost_ms for result in forecasts])
        played = sum(way.samples for result in forecasts for way in (result, *result.alternatives))
        won, lost = count_discordant(before, after)
        table.add_row(
            scene,
            str(Rate(sum(before), len(before))),
            str(Rate(sum(after), len(after))),
            f"{won}, {lost}",
            f"{compute_mcnemar(before, after):.2g}",
            str(sum(each.revisions for each in careful)),
            f"{played} in {len(forecasts)}",
            f"{cost.median:.0f}, {cost.p95:.0f}",
        )
    console.print(table)


def compute_figures(without: dict[str, list[Try]], ahead: dict[str, list[Try]]) -> dict[str, float]:
    """Pooled over the scenes, and the counts of each."""
    before = [each.first for tries in without.values() for each in tries]
    after = [each.first for tries in ahead.values() for each in tries]
    both = [each for arm in (without, ahead) for tries in arm.values() for each in tries]
    forecasts = [result for tries in ahead.values() for each in tries for result in each.forecasts]
    cost = Spread.of([result.cost_ms for result in forecasts])
    figures = {
        "first_attempts_without": Rate(sum(before), len(before)).value,
        "first_attempts_with": Rate(sum(after), len(after)).value,
        "gain": (sum(after) - sum(before)) / len(before),
        "mcnemar_p": compute_mcnemar(before, after),
        "false_successes": float(sum(each.is_false for each in both)),
        "pairs": float(len(before)),
        "forecasts": float(len(forecasts)),
        "cost_ms_median": cost.median,
        "cost_ms_p95": cost.p95,
    }
    for name, arm in (("without", without), ("with", ahead)):
        figures |= {f"{scene}_{name}": float(sum(each.first for each in tries)) for scene, tries in arm.items()}
    return figures


def main() -> int:
    """Run, show, and exit with whether every asked figure holds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--scene", choices=tuple(SCENES), action="append", help="only these")
    parser.add_argument(
        "--sense", choices=("perceived", "truth"), default="perceived", help="what robot, verifier and look-ahead go by"
    )
    parser.add_argument("--keep", type=Path, help="folder for the workspaces, kept afterwards")
    given = parser.parse_args()
    console = Console(stderr=True)
    seeds = range(given.first_seed, given.first_seed + given.seeds)
    without: dict[str, list[Try]] = {}
    ahead: dict[str, list[Try]] = {}
    with tempfile.TemporaryDirectory(prefix="lookahead-") as scratch:
        base = given.keep or Path(scratch)
        for scene in given.scene or SCENES:
            without[scene] = run_arm(base, scene, seeds, False, given.sense, console)
            ahead[scene] = run_arm(base, scene, seeds, True, given.sense, console)
    show(Console(width=TABLE_WIDTH), without, ahead)
    figures = compute_figures(without, ahead)
    line, holds = format_outcome(figures, ASKED)
    print(line)
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
