"""`paos run`: a live view until the verdict, and a report. What runs is `assembly.mission_run`."""

import inspect
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from phyagentos.assembly.mission_run import Interrupts, PlaneEnded, RunOrder, run_goal
from phyagentos.assembly.progress import RunFold
from phyagentos.assembly.project import get_file
from phyagentos.cli.arguments import Overrides, TrustPython
from phyagentos.cli.console import CleanConsole, RunConsole
from phyagentos.cli.lint import FileKind, find_other_kind
from phyagentos.cli.outcome import Exit, ExitCode, print_json, print_note
from phyagentos.cli.report import build_report, compute_exit_code, print_report
from phyagentos.cli.running import FaultFile, Graph, Known, Mode, Seed, Sense, Verify, WhichMemory
from phyagentos.clock import Clock, SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.sessions.estop import read_latch

WARM_UP_S = 6.0  # a machine that has compiled its kernels moves before
_FOLDER_HELP = "Folder of the run; a new one under workspaces/ by default."


@dataclass(frozen=True, slots=True, kw_only=True)
class Order(RunOrder):
    """What is asked for; each field is an option of `paos run`."""

    graph: Graph
    seed: Seed = 0
    workspace: Annotated[Path | None, typer.Option("--workspace", "-w", help=_FOLDER_HELP)] = None
    faults: FaultFile = None
    overrides: Overrides = None
    as_json: Annotated[bool, typer.Option("--json", help="One JSON report on stdout, all else on stderr.")] = False
    pictures: Annotated[bool, typer.Option(" /--no-pictures", help="Render nothing.", show_default=False)] = True
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Only the final table.")] = False
    world_mode: Mode = None
    verify: Verify = None
    sense: Sense = None
    prior: Known = None
    memory: WhichMemory = None
    trusts_python: TrustPython = False


def run(**options: Any) -> int:
    """Run a goal graph to its verdict: both planes, live progress, a final table."""
    return run_mission(Order(**options))


run.__dict__["__signature__"] = inspect.signature(Order)  # whose fields are the options


def run_mission(order: Order) -> int:
    """Run a goal graph to its verdict; raises DefinitionError before anything is started, Exit when a plane failed."""
    clock, interrupts, graph = SystemClock(), Interrupts(), get_file(order.graph, "goal_graphs")
    problems, started_s = find_other_kind(graph, FileKind.GOAL_GRAPH), clock.now_s()
    if order.faults is not None:
        problems += find_other_kind(get_file(order.faults, "faults"), FileKind.FAULTS)
    if problems:
        raise DefinitionError(problems)
    with RunConsole(f"{graph.stem}, seed {order.seed}", quiet=order.quiet) as console:
        show = partial(show_run, console, interrupts, clock, started_s + WARM_UP_S)
        try:
            fold = run_goal(order, interrupts, clock, print_note, show)
        except PlaneEnded as error:
            if error.exit_code in {ExitCode.INVALID_INPUT, ExitCode.REJECTED}:
                raise Exit(ExitCode(error.exit_code), "\n".join(error.printed)) from error
            raise Exit(ExitCode.INTERNAL_ERROR, error.message) from error
    code = ExitCode.INTERRUPTED if interrupts.count else compute_exit_code(fold)
    report = build_report(fold, workspace=fold.workspace.root, wall_s=clock.now_s() - started_s, exit_code=code)
    if order.as_json:
        print_json(report)
    print_report(report, fold, CleanConsole(stderr=order.as_json, highlight=False))
    return int(code)


def show_run(console: RunConsole, interrupts: Interrupts, clock: Clock, warm_by_s: float, fold: RunFold) -> None:
    """Bring the view up to date; under a latched emergency stop, say why nothing moves."""
    console.show(fold)
    if (latch := read_latch(fold.workspace.signals.parent)) is not None:
        why = f"emergency stop latched by {latch.by or '?'} ({latch.reason or 'no reason given'})"
        way_out = f"paos estop -w {fold.workspace.root} --reset --reason ... lets it go on."
        console.print_once(f"{why}; {way_out}", "red", even_quiet=True)
    has_moved = any(row.sim_time_s or (row.beat is not None and row.beat.tick) for row in fold.rows())
    if clock.now_s() > warm_by_s and not has_moved:
        console.print_once("warming up: a first run compiles its kernels; `paos doctor --warm` does so ahead")
    if interrupts.count:
        console.print_once("cancelling: the robot is being halted. Ctrl-C again ends at once.", "yellow")
