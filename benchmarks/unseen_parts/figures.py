"""Figures of many goals: rates with exact intervals, tables, and the reasons of failures grouped by code."""

from collections import Counter
from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.table import Table

from benchmarks.runner import show
from benchmarks.unseen_parts.records import GoalRecord, NodeRecord, SessionRecord, iter_findings
from phyagentos.bench.report import Threshold

ASKED = {
    "feasible_goals_met": Threshold(0.90, at_least=True),
    "feasible_nodes_first_attempt": Threshold(0.90, at_least=True),
    "false_successes": Threshold(0, at_least=False),
    "judged_sessions": Threshold(1000, at_least=True),
    "judged_unmet_in_truth": Threshold(300, at_least=True),
    "goals": Threshold(300, at_least=True),
    "false_failures": Threshold(0.02, at_least=False),
    "infeasible_refused": Threshold(0.95, at_least=True),
    "crashed": Threshold(0, at_least=False),
    "hung": Threshold(0, at_least=False),
}


class Tally:
    """What the goals of one table came to; each seed counts once."""

    def __init__(self, records: Iterable[GoalRecord]) -> None:
        self.goals: Sequence[GoalRecord] = list({record.seed: record for record in records}.values())
        self.sessions = [session for goal in self.goals for session in goal.sessions if session.is_judged]

    @property
    def feasible(self) -> list[GoalRecord]:
        """Goals that can be met, for all that the script knows."""
        return [goal for goal in self.goals if goal.feasible == "yes"]

    @property
    def first_attempts(self) -> list[NodeRecord]:
        """Feasible nodes of goals without a fault: a fault may make a first attempt fail rightly.

        A node that was never begun, behind one that cannot be met, cannot be met either.
        """
        whole = [goal for goal in self.goals if not goal.faults]
        return [n for goal in whole for n in goal.nodes if n.feasible == "yes" and n.name not in goal.blocked]

    @property
    def infeasible(self) -> list[GoalRecord]:
        """Goals that cannot be met, for certain."""
        return [goal for goal in self.goals if goal.feasible == "no"]

    @property
    def met(self) -> list[SessionRecord]:
        """Sessions that clearly met their objective in truth, but for those that only asked to look again.

        Where every camera lies or is dark, or a node names one of two equal objects, nothing can be known: those count
        for false successes alone.
        """
        seeing = [goal for goal in self.goals if not any(fault.endswith("*") for fault in goal.faults)]
        doubtful = {(goal.seed, node.name) for goal in seeing for node in goal.nodes if node.is_ambiguous}
        judged = ((goal.seed, s) for goal in seeing for s in goal.sessions if s.is_judged and s.is_clearly_met)
        return [s for seed, s in judged if (seed, s.node) not in doubtful]

    @property
    def ambiguous(self) -> list[tuple[GoalRecord, NodeRecord]]:
        """Nodes that name one of two objects that nobody could tell apart: neither met nor missed."""
        return [(goal, node) for goal in self.goals for node in goal.nodes if node.is_ambiguous]

    @property
    def false_successes(self) -> int:
        """Verdicts of sessions and of goals that say success of what is not so."""
        return sum(s.is_false_success for s in self.sessions) + sum(goal.is_false_success for goal in self.goals)

    def build_figures(self) -> dict[str, float]:
        """The numbers of the closing line."""
        rates = {
            "feasible_goals_met": (sum(goal.is_met for goal in self.feasible), len(self.feasible)),
            "feasible_nodes_first_attempt": (sum(n.first for n in self.first_attempts), len(self.first_attempts)),
            "false_failures": (sum(s.is_false_failure for s in self.met), len(self.met)),
            "infeasible_refused": (sum(goal.is_refused for goal in self.infeasible), len(self.infeasible)),
        }
        figures = {name: ok / count if count else float("nan") for name, (ok, count) in rates.items()}
        return figures | {
            "goals": float(len(self.goals)),
            "judged_sessions": float(len(self.sessions)),
            "judged_unmet_in_truth": float(sum(session.truth == "unmet" for session in self.sessions)),
            "judged_open": float(sum(session.truth == "open" for session in self.sessions)),
            "false_successes": float(self.false_successes),
            "false_success_bound": find_interval(self.false_successes, len(self.sessions))[1],
            "crashed": float(sum(goal.ended == "crashed" for goal in self.goals)),
            "hung": float(sum(goal.ended == "hung" for goal in self.goals)),
        }

    def show(self, console: Console, title: str) -> None:
        """The tables, every finding, and the reasons of failures by code."""
        table = Table("", "count", "share [95 % interval, Clopper-Pearson]", title=title)
        figures = self.build_figures()
        rows = (
            ("feasible goals met", [goal.is_met for goal in self.feasible]),
            ("feasible nodes met at first attempt, no fault", [node.first for node in self.first_attempts]),
            ("false successes of judged sessions and goals", [True] * self.false_successes),
            ("false failures of sessions met in truth", [session.is_false_failure for session in self.met]),
            ("infeasible goals refused before motion", [goal.is_refused for goal in self.infeasible]),
        )
        for name, values in rows:
            count = len(self.sessions) if name.startswith("false successes") else len(values)
            low, high = find_interval(sum(values), count)
            table.add_row(name, f"{sum(values)} of {count}", f"[{low:.4f}, {high:.4f}]")
        for name in ("judged_unmet_in_truth", "judged_open", "crashed", "hung"):
            table.add_row(name.replace("_", " "), f"{figures[name]:.0f}", "")
        blocked = sum(
            node.feasible == "yes" and node.name in goal.blocked for goal in self.goals for node in goal.nodes
        )
        table.add_row("feasible nodes not begun, behind one that cannot be met", f"{blocked}", "")
        planted = sum(len(goal.faults) for goal in self.goals)
        table.add_row("faults that never struck", f"{sum(len(goal.unstruck) for goal in self.goals)} of {planted}", "")
        console.print(table)
        for goal in self.goals:
            for finding in iter_findings(goal):
                console.print(finding, highlight=False, markup=False)
        for goal, node in self.ambiguous:
            told = next((s for s in reversed(goal.sessions) if s.node == node.name), None)
            end = f"{told.verdict or 'refused'} {told.cause}: {told.reason[:120]}" if told else "not begun"
            console.print(f"twins: seed {goal.seed}, {node.name}: {node.why}; {end}", highlight=False, markup=False)
        self._show_reasons(console)

    def _show_reasons(self, console: Console) -> None:
        causes = Counter(
            find_code(s) for goal in self.feasible for s in goal.sessions if s.verdict not in {"", "success"}
        )
        show(
            "sessions of feasible goals that were not met, by skill, code and cause",
            ("reason", "sessions"),
            ((name, str(count)) for name, count in causes.most_common()),
        )
        for goal in self.feasible:
            if not goal.is_met and goal.ended == "over":
                console.print(f"seed {goal.seed}: {goal.reason[:220]}", style="dim", highlight=False, markup=False)


def find_code(session: SessionRecord) -> str:
    """Skill, code of the execution and cause of the verdict."""
    return f"{session.skill} {session.code or '-'} {session.cause or '-'}"


def find_interval(successes: int, trials: int) -> tuple[float, float]:
    """Clopper-Pearson, 95 %; everything is possible without trials."""
    from scipy.stats import binomtest  # half a second to load, for figures alone

    if not trials:
        return 0.0, 1.0
    found = binomtest(min(successes, trials), trials).proportion_ci(0.95, method="exact")
    return float(found.low), float(found.high)
