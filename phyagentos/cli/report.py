"""How a run ended, for people."""

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from phyagentos.cli.console import build_criterion_line, choose_style, summarise, tell_failure
from phyagentos.cli.outcome import ExitCode
from phyagentos.operations.progress import Row
from phyagentos.operations.run import RunReport

PIPE_WIDTH = 160  # characters of a table that no terminal bounds


def print_report(report: RunReport, rows: Sequence[Row], console: Console) -> None:
    """The final table, the goal's own criteria, and where the pictures are; `paos why` explains more."""
    if not console.is_terminal:
        console.width = PIPE_WIDTH
    table = Table(box=None, pad_edge=False, header_style="dim")
    for column in ("node", "session", "state", "verdict", "because"):
        table.add_column(column, overflow="fold")
    table.add_column("simulated", justify="right", no_wrap=True)
    table.add_column("wall", justify="right", no_wrap=True)
    for row in rows:
        failed = " (execution failed)" if tell_failure(row) else ""
        table.add_row(
            row.node,
            row.session.contract.id if row.session is not None else "",
            Text(row.state, choose_style(row, row.state)),
            Text(row.verdict + failed, choose_style(row, row.verdict)),
            summarise(row),
            f"{row.sim_time_s:.1f} s" if row.sim_time_s else "",
            f"{row.wall_s:.1f} s" if row.session is not None else "",
        )
    console.print()
    console.print(table)
    console.print()
    goal = report.goal
    if goal is not None:
        is_met = report.exit_code == ExitCode.GOAL_MET
        word, style = ("met", "bold green") if is_met else ("not met", "bold red")
        console.print(Text.assemble(f"goal {goal.goal}: ", (word, style), f"  {goal.reason}"))
        for criterion in goal.criteria:
            console.print(build_criterion_line(criterion))
        refused = [row.session.reason for row in rows if row.session is not None and row.session.problems]
        for reason in (each for each in refused if each not in goal.reason):
            console.print(reason, soft_wrap=True)
    for fault in report.unstruck_faults:
        console.print(f"fault {fault} never struck", style="yellow", soft_wrap=True)
    for pictures in report.pictures.values():
        for picture in pictures:
            console.print(f"picture {picture}", style="dim", soft_wrap=True)
    console.print(f"documents in {report.workspace}", style="dim", soft_wrap=True)
