"""How a run ended: one report, as JSON for programs and as a table for people, from journal and evidence alone."""

from pathlib import Path

import msgspec
from rich.console import Console
from rich.table import Table
from rich.text import Text

from phyagentos.agent.mission.report import MissionReport
from phyagentos.agent.mission.report import build_report as build_mission_report
from phyagentos.assembly.planted_faults import find_unstruck
from phyagentos.assembly.progress import RunFold
from phyagentos.cli.console import build_criterion_line, choose_style, summarise, tell_failure
from phyagentos.cli.outcome import ExitCode
from phyagentos.protocol.sessions.evidence import PICTURE_AFTER, PICTURE_BEFORE

PIPE_WIDTH = 160  # characters of a table that no terminal bounds


class RunReport(msgspec.Struct, frozen=True, kw_only=True):
    """What `paos run --json` prints.

    Attributes:
        report: Version of this format.
        wall_s: Of the whole command, both planes started and ended [s].
        pictures: Session -> files.
    """

    report: int = 1
    exit_code: int
    workspace: str
    wall_s: float
    pictures: dict[str, tuple[str, ...]]
    goal: MissionReport | None
    unstruck_faults: tuple[str, ...] = ()


def compute_exit_code(fold: RunFold) -> ExitCode:
    """Recorded end of the goal."""
    goal = fold.goal
    if goal is None or not (goal.verdict or goal.is_cancelled):
        return ExitCode.INTERNAL_ERROR
    return ExitCode(build_mission_report(goal, fold.ledger, 0.0).exit_code)


def build_report(fold: RunFold, *, workspace: Path, wall_s: float, exit_code: ExitCode) -> RunReport:
    """The whole run in one value."""
    goal = fold.goal
    sessions = [row.session.contract.id for row in fold.rows() if row.session is not None]
    pairs = {id: [workspace / "evidence" / id / name for name in (PICTURE_BEFORE, PICTURE_AFTER)] for id in sessions}
    pictures = {id: tuple(str(path) for path in pair if path.is_file()) for id, pair in pairs.items()}
    return RunReport(
        exit_code=int(exit_code),
        workspace=str(workspace),
        wall_s=round(wall_s, 3),
        pictures={id: found for id, found in pictures.items() if found},
        goal=build_mission_report(goal, fold.ledger, round(wall_s, 3)) if goal is not None else None,
        unstruck_faults=find_unstruck(workspace),
    )


def print_report(report: RunReport, fold: RunFold, console: Console) -> None:
    """The final table, the goal's own criteria, and where the pictures are; `paos why` explains more."""
    if not console.is_terminal:
        console.width = PIPE_WIDTH
    table = Table(box=None, pad_edge=False, header_style="dim")
    for column in ("node", "session", "state", "verdict", "because"):
        table.add_column(column, overflow="fold")
    table.add_column("simulated", justify="right", no_wrap=True)
    table.add_column("wall", justify="right", no_wrap=True)
    for row in fold.rows():
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
        refused = [row.session.reason for row in fold.rows() if row.session is not None and row.session.problems]
        for reason in (each for each in refused if each not in goal.reason):
            console.print(reason, soft_wrap=True)
    for fault in report.unstruck_faults:
        console.print(f"fault {fault} never struck", style="yellow", soft_wrap=True)
    for pictures in report.pictures.values():
        for picture in pictures:
            console.print(f"picture {picture}", style="dim", soft_wrap=True)
    console.print(f"documents in {report.workspace}", style="dim", soft_wrap=True)
