"""Four ways to recover, side by side on the same seeds, faults and budgets, judged by an eye of its own.

    python benchmarks/recovery.py --seeds 4
    python benchmarks/recovery.py --unseen 40     # goals in rooms drawn from seeds, as of benchmarks/unseen.py

No retry, blind retry, full restart and graph repair are strategies behind one port (`RepairPolicy`): mission loop,
verifier, runtime and budget are the same. Every goal names its budget of sessions; the set holds cases in which a
restart no longer fits it, in which a restart undoes what stood (a tower), and in which a thing cannot be had again.
Success is read from the recorded simulator state by eyes of their own (`judge`, `eye`, the judge of unseen worlds);
that the mission said so does not count.
"""

import argparse
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest, wilcoxon

from benchmarks.recovery_parts.baselines import BlindRetry, FullRestart, NoRetry, recovering_by
from benchmarks.recovery_parts.eye import is_in_box, is_on
from benchmarks.recovery_parts.trials import Trial, draw_trials, judge_last_by
from phyagentos.agent.repair.recovery_policies import GraphRepair, RepairPolicy
from phyagentos.assembly.agent_plane import MemoryUse
from phyagentos.assembly.paths import open_project
from phyagentos.bench.report import Ask, Rate, Spread, format_outcome
from phyagentos.bench.scorers.simulator_state import is_in_tray
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.protocol.settings.perception import Sensing
from phyagentos.protocol.workspace.workspace import Workspace

ROOT = Path(__file__).resolve().parents[1]
PARTS = Path(__file__).resolve().parent / "recovery_parts"
ZONE = ((0.5, -0.32), (0.08, 0.08))  # as in scenes/recovery/workshop.yaml: middle and half sides [m]
SIGNIFICANT = 0.05
DEVELOPMENT, HELD_OUT = 20_000, 1_500_000  # first seeds of drawn rooms
POLICIES: dict[str, Callable[[], RepairPolicy]] = {
    "no retry": NoRetry,
    "blind retry": BlindRetry,
    "full restart": FullRestart,
    "repair": GraphRepair,
}
ASKED = {
    "success_p_against_no_retry": Ask(SIGNIFICANT, at_least=False),
    "success_p_against_blind_retry": Ask(SIGNIFICANT, at_least=False),
    "success_p_against_full_restart": Ask(SIGNIFICANT, at_least=False),
    "sessions_p_against_blind_retry": Ask(SIGNIFICANT, at_least=False),
    "sessions_p_against_full_restart": Ask(SIGNIFICANT, at_least=False),
}

Eye = Callable[[Path], bool]


@dataclass(frozen=True, slots=True)
class Case:
    """One kind of goal and what goes wrong in it.

    Attributes:
        name: Also the beginning of its goals' ids, by which the fault file knows them.
        graph: File under recovery_parts, without suffix.
        story: What happens.
        is_met: Whether the last recorded world shows the goal met.
    """

    name: str
    graph: str
    story: str
    is_met: Eye


@dataclass(frozen=True, slots=True)
class Run:
    """One goal under one policy."""

    case: str
    seed: int
    is_met: bool
    sessions: int
    sim_time_s: float
    verdict: str
    reason: str


def is_tidy(folder: Path) -> bool:
    """All three cubes in their trays."""
    return all(is_in_tray(folder, f"{color}_cube", f"{color}_tray") for color in ("red", "green", "blue"))


def is_tower(folder: Path) -> bool:
    """Red on the pad, green on red, blue on green."""
    pairs = (("red_block", "pad"), ("green_block", "red_block"), ("blue_block", "green_block"))
    return all(is_on(folder, *pair) for pair in pairs)


CASES = (
    Case("tidy_slip", "tidy", "the last cube slips out; a restart does not fit the budget", is_tidy),
    Case("tidy_nudge", "tidy", "the second cube is knocked aside", is_tidy),
    Case("tidy_move", "tidy", "a person moves the last cube", is_tidy),
    Case("tidy_stall", "tidy", "a motor seizes at the first cube", is_tidy),
    Case("tidy_undone", "tidy", "a person takes the first cube out of its tray again", is_tidy),
    Case("tidy_taken", "tidy", "a person takes a cube away for good: it cannot be had again", is_tidy),
    Case("tower_moved", "tower", "a person moves the last block; a restart builds the whole tower again", is_tower),
    Case(
        "hemmed",
        "hemmed",
        "posts stand too close to the cube for the fingers",
        lambda folder: is_in_tray(folder, "green_cube", "green_tray") and is_in_tray(folder, "red_cube", "red_tray"),
    ),
    Case(
        "wide",
        "wide",
        "the carton is wider than the hand opens",
        lambda folder: is_in_tray(folder, "green_cube", "green_tray") and is_in_box(folder, "carton", *ZONE),
    ),
    Case(
        "slippery",
        "slippery",
        "the soap slips out at full speed",
        lambda folder: is_in_tray(folder, "green_cube", "green_tray") and is_in_tray(folder, "soap", "red_tray"),
    ),
)


def list_trials(cases: Sequence[Case], seeds: Sequence[int]) -> list[Trial]:
    """Every case with every seed."""
    return [
        Trial(case.name, seed, PARTS / f"{case.graph}.yaml", f"{case.name}-{seed}", judge_last_by(case.is_met))
        for case in cases
        for seed in seeds
    ]


def run_policy(
    workspace: Workspace, policy: RepairPolicy, trials: Sequence[Trial], faults: Path, sense: str | None, told: Console
) -> list[Run]:
    """Every trial under one policy, in one warm runtime plane."""
    runs = []
    bench = open_bench(
        workspace,
        SystemClock(),
        faults=faults,
        sense=Sensing(sense) if sense else None,
        memory_use=MemoryUse.NONE,  # goals are independent trials: what one teaches would help the next
        policy=policy,
    )
    with recovering_by(policy), bench as agent:
        for trial in trials:
            report = agent.mission.run(trial.graph, seed=trial.seed, goal=GoalId(trial.goal))
            last = Run(
                case=trial.case,
                seed=trial.seed,
                is_met=trial.is_met(workspace.evidence, report),
                sessions=len(report.sessions),
                sim_time_s=sum(session.sim_time_s for session in report.sessions),
                verdict=report.verdict,
                reason=report.reason,
            )
            runs.append(last)
            line = f"{policy.name}: {last.case} seed {last.seed}: met {last.is_met}, {last.sessions} sessions"
            told.print(line if last.is_met else f"{line}; {last.reason[:200]}", style="dim", highlight=False)
    return runs


def compute_success_p(ours: Sequence[Run], theirs: Sequence[Run]) -> float:
    """One-sided exact McNemar test that we succeed more often on the same goals (doi:10.1007/BF02295996)."""
    better = sum(a.is_met and not b.is_met for a, b in zip(ours, theirs, strict=True))
    worse = sum(b.is_met and not a.is_met for a, b in zip(ours, theirs, strict=True))
    return float(binomtest(better, better + worse, alternative="greater").pvalue) if better + worse else 1.0


def compute_sessions_p(ours: Sequence[Run], theirs: Sequence[Run]) -> float:
    """One-sided Wilcoxon signed-rank test that we execute fewer sessions on the same goals."""
    differences = [a.sessions - b.sessions for a, b in zip(ours, theirs, strict=True)]
    return float(wilcoxon(differences, alternative="less").pvalue) if any(differences) else 1.0


def show(console: Console, runs: dict[str, list[Run]], figures: dict[str, float]) -> None:
    """The tables."""
    table = Table(title="recovery: the same goals, seeds, faults and budgets")
    for column in ("", *runs):
        table.add_column(column)
    table.add_row(
        "goals met, by the world", *(str(Rate(sum(r.is_met for r in each), len(each))) for each in runs.values())
    )
    table.add_row("sessions executed", *(str(sum(r.sessions for r in each)) for each in runs.values()))
    table.add_row(r"simulated time \[s]", *(f"{sum(r.sim_time_s for r in each):.0f}" for each in runs.values()))
    table.add_row(
        r"simulated time of a goal, median \[s]",
        *(f"{Spread.of([r.sim_time_s for r in each]).median:.1f}" for each in runs.values()),
    )
    table.add_row(
        "verdict success, world says no",
        *(str(sum(r.verdict == "success" and not r.is_met for r in each)) for each in runs.values()),
    )
    for what in ("success", "sessions"):
        values = (figures.get(f"{what}_p_against_{name.replace(' ', '_')}") for name in runs)
        table.add_row(f"p: repair is better on {what}", *("" if p is None else f"{p:.4f}" for p in values))
    console.print(table)
    by_case = Table(title="goals met / sessions, by case")
    for column in ("case", "what happens", *runs):
        by_case.add_column(column)
    stories = {case.name: case.story for case in CASES}
    for case in dict.fromkeys(run.case for run in next(iter(runs.values()))):
        cells = []
        for each in runs.values():
            mine = [run for run in each if run.case == case]
            cells.append(f"{sum(run.is_met for run in mine)}/{len(mine)}, {sum(run.sessions for run in mine)}")
        by_case.add_row(case, stories.get(case, ""), *cells)
    console.print(by_case)
    for run in runs.get("repair", ()):
        if not run.is_met:
            text = f"repair did not meet {run.case} seed {run.seed}: {run.verdict}: {run.reason[:300]}"
            console.print(text, highlight=False, markup=False)


def main() -> int:
    """Run, show, and exit with whether every asked figure holds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=4, help="goals of each case")
    parser.add_argument("--first-seed", type=int, default=400, help="those below were used while this was made")
    parser.add_argument("--cases", nargs="*", choices=[case.name for case in CASES], help="only these")
    parser.add_argument("--unseen", type=int, default=0, metavar="GOALS", help="goals in drawn rooms instead")
    parser.add_argument("--development", action="store_true", help="with --unseen: seeds for development")
    parser.add_argument("--policies", nargs="*", choices=list(POLICIES), help="only these; no figure is asked then")
    parser.add_argument("--sense", choices=("truth", "perceived"), help="what agent and skills see; else the default")
    parser.add_argument("--keep", type=Path, help="folder for the workspaces, kept afterwards")
    given = parser.parse_args()
    console = Console(stderr=True)
    names = [name for name in POLICIES if not given.policies or name in given.policies]
    with tempfile.TemporaryDirectory(prefix="recovery-") as scratch:
        base = given.keep or Path(scratch)
        project, faults = ROOT, PARTS / "faults.yaml"
        if given.unseen:
            project, faults = base / "project", base / "project" / "faults.yaml"
            trials = draw_trials(DEVELOPMENT if given.development else HELD_OUT, given.unseen, project)
        else:
            cases = [case for case in CASES if not given.cases or case.name in given.cases]
            trials = list_trials(cases, range(given.first_seed, given.first_seed + given.seeds))
        runs = {
            name: run_policy(
                open_project(base / name.replace(" ", "_"), project, ROOT),
                POLICIES[name](),
                trials,
                faults,
                given.sense,
                console,
            )
            for name in names
        }
    figures: dict[str, float] = {}
    for name, each in runs.items():
        key = name.replace(" ", "_")
        figures[f"{key}_success"] = Rate(sum(run.is_met for run in each), len(each)).value
        figures[f"{key}_sessions"] = float(sum(run.sessions for run in each))
        figures[f"{key}_sim_time_s"] = sum(run.sim_time_s for run in each)
        if name != "repair" and "repair" in runs:
            figures[f"success_p_against_{key}"] = compute_success_p(runs["repair"], each)
            figures[f"sessions_p_against_{key}"] = compute_sessions_p(runs["repair"], each)
    figures["goals"] = float(len(trials))
    show(Console(), runs, figures)
    wanted = [name for name in ASKED if not given.unseen or name.startswith("success")]  # sessions are of one table
    asked = {name: ASKED[name] for name in wanted if name in figures}
    line, holds = format_outcome(figures, asked)
    print(line)
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
