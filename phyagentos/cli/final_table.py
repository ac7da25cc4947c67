"""How a run ended, for people."""

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.text import Text

from phyagentos.cli.console import PIPE_WIDTH, build_table, choose_style, print_criteria, summarise, tell_failure
from phyagentos.cli.outcome import ExitCode
from phyagentos.operations.progress import Row
from phyagentos.operations.run import RunReport
from phyagentos.operations.workspaces import FOLDER


def print_report(report: RunReport, rows: Sequence[Row], console: Console) -> None:
    """The final table, the goal's own criteria, where pictures and documents are, and what to type next."""
    if not console.is_terminal:
        console.width = PIPE_WIDTH
    table = build_table(("session", "state", "because", "simulated", "wall"), map(_list_cells, rows))
    for column in table.columns[-2:]:
        column.justify, column.no_wrap = "right", True
    console.print()
    console.print(table)
    console.print()
    goal = report.goal
    if goal is not None:
        is_met = report.exit_code == ExitCode.GOAL_MET
        word, style = ("met", "bold green") if is_met else ("not met", "bold red")
        console.print(Text.assemble(f"goal {goal.goal}: ", (word, style), f"  {goal.reason}"))
        print_criteria(goal.criteria, console, goal.reason)
        refused = [row.session.reason for row in rows if row.session is not None and row.session.problems]
        for reason in (each for each in refused if each not in goal.reason):
            console.print(reason, soft_wrap=True)
    for fault in report.unstruck_faults:
        console.print(f"fault {fault} never struck", style="yellow", soft_wrap=True)
    pictures = [picture for pair in report.pictures.values() for picture in pair]
    if pictures:
        more = f", and {len(pictures) - 1} more in evidence/" if pictures[1:] else ""
        console.print(f"picture {pictures[-1]}{more}", style="dim", soft_wrap=True)
    console.print(f"documents in {report.workspace}", style="dim", soft_wrap=True)
    where = "" if Path(report.workspace).resolve().parent == FOLDER.resolve() else f" -w {report.workspace}"
    console.print(f"next: paos why{where} (what decided)", soft_wrap=True)
    console.print(f"      paos view{where} (the run, on a page)", soft_wrap=True)


def _list_cells(row: Row) -> tuple[str | Text, ...]:
    failed = " (execution failed)" if tell_failure(row) else ""
    return (
        row.name,
        Text(row.state + failed, choose_style(row, row.state)),
        summarise(row),
        f"{row.sim_time_s:.1f} s" if row.sim_time_s else "",
        f"{row.wall_s:.1f} s" if row.session is not None else "",
    )
