"""`paos doctor`: whether this machine can run what the project promises, and what to do where it cannot."""

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from phyagentos.cli.console import CleanConsole, build_table
from phyagentos.cli.outcome import ExitCode, print_note
from phyagentos.cli.reply import Reply
from phyagentos.clock import Clock, SystemClock
from phyagentos.operations import doctor
from phyagentos.operations.doctor import Grade, MachineFinding

STYLES = {Grade.FINE: "green", Grade.WEAK: "yellow", Grade.BROKEN: "bold red"}


def examine_machine(
    folder: Annotated[Path, typer.Argument(help="Where workspaces will stand.")] = Path(),
    warm: Annotated[bool, typer.Option("--warm", help="Only compile every kernel that is not kept yet.")] = False,
) -> Reply[tuple[MachineFinding, ...]]:
    """Check this machine: graphics, locks, file events, clock, versions, ports, disk; print each fix."""
    found = (warm_kernels(SystemClock()),) if warm else doctor.examine_machine(folder)
    rows = ((each.subject, Text(each.grade, STYLES[each.grade]), each.found, each.fix) for each in found)
    is_broken = any(each.grade is Grade.BROKEN for each in found)
    table = build_table(("subject", "grade", "found", "what to do"), rows)
    return Reply(found, table, code=ExitCode.GOAL_NOT_MET if is_broken else ExitCode.GOAL_MET)


def warm_kernels(clock: Clock) -> MachineFinding:
    """Compile kernels; a terminal shows which it is at, anything else that it began."""
    began_s, names = clock.now_s(), list[str]()
    with CleanConsole(stderr=True).status("looking at kernels") as status:

        def show(name: str) -> None:
            if not names and not status.console.is_terminal:
                print_note("compiling kernels, half a minute, once for this version")
            names.append(name)
            status.update(f"compiling kernel {len(names)}, {name}, {clock.now_s() - began_s:.0f} s")

        return doctor.warm_kernels(clock, show)
