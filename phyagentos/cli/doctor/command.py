"""The command: every check, one table, exit 1 where something is broken."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from phyagentos.cli.doctor import disk, software, system
from phyagentos.cli.doctor.finding import Finding, Grade
from phyagentos.cli.outcome import Exit, ExitCode, print_result
from phyagentos.clock import Clock, SystemClock
from phyagentos.errors import DefinitionError, Problem

STYLES = {Grade.FINE: "green", Grade.WEAK: "yellow", Grade.BROKEN: "bold red"}


def register(app: typer.Typer) -> None:
    """Add this group's commands."""
    app.command("doctor")(examine_machine)


def examine_machine(
    folder: Annotated[Path, typer.Argument(help="Where workspaces will stand.")] = Path(),
    as_json: Annotated[bool, typer.Option("--json", help="One JSON list on stdout.")] = False,
) -> None:
    """Check this machine: graphics, locks, file events, clock, versions, ports, disk; tell each fix."""
    if not folder.is_dir():
        raise DefinitionError(Problem(code="UNKNOWN_FOLDER", address=str(folder), expected="a folder that exists"))
    findings = list(iter_findings(folder, SystemClock()))
    if as_json:
        print_result(msgspec.json.format(msgspec.json.encode(findings)).decode())
    else:
        Console(highlight=False).print(_build_table(findings))
    if any(each.grade is Grade.BROKEN for each in findings):
        raise Exit(ExitCode.GOAL_NOT_MET)


def iter_findings(folder: Path, clock: Clock) -> Iterator[Finding]:
    """Every check, one after the other; scratch files are made and removed in `folder`."""
    yield software.check_python()
    yield software.check_packages()
    yield software.check_graphics()
    for check in disk.CHECKS:
        try:
            yield check(folder, clock)
        except OSError as error:
            subject = check.__name__.removeprefix("check_").replace("_", " ")
            yield Finding(subject, Grade.BROKEN, str(error), f"Make {folder} a folder that you may write to.")
    yield system.check_scheduling()
    yield system.check_ports()


def _build_table(findings: list[Finding]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim")
    for column in ("subject", "grade", "found", "what to do"):
        table.add_column(column, overflow="fold")
    for each in findings:
        table.add_row(each.subject, Text(each.grade, STYLES[each.grade]), Text(each.found), Text(each.fix))
    return table
