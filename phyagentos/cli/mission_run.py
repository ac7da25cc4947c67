"""`paos run`: a live view until the verdict, and a report. What runs is `assembly.mission_run`."""

from functools import partial

from phyagentos.assembly.mission_run import Interrupts, PlaneEnded, RunOrder, run_goal
from phyagentos.assembly.progress import RunFold
from phyagentos.assembly.project import get_file
from phyagentos.cli.console import CleanConsole, RunConsole
from phyagentos.cli.lint import FileKind, find_other_kind
from phyagentos.cli.outcome import Exit, ExitCode, print_json, print_note
from phyagentos.cli.report import build_report, compute_exit_code, print_report
from phyagentos.clock import Clock, SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.sessions.estop import read_latch
from phyagentos.protocol.workspace.workspace import Workspace

WARM_UP_S = 6.0  # a machine that has compiled its kernels moves before


def run_mission(order: RunOrder, clock: Clock | None = None, *, as_json: bool = False, quiet: bool = False) -> int:
    """Run a goal graph to its verdict; returns the exit code.

    Raises:
        DefinitionError: Before anything is started.
        Exit: When a plane failed, with its own code where it is one of ours.
    """
    clock, interrupts = clock or SystemClock(), Interrupts()
    graph, started_s = get_file(order.graph, "goal_graphs"), clock.now_s()
    problems = find_other_kind(graph, FileKind.GOAL_GRAPH)
    if order.faults is not None:
        problems += find_other_kind(get_file(order.faults, "faults"), FileKind.FAULTS)
    if problems:
        raise DefinitionError(problems)
    with RunConsole(f"{graph.stem}, seed {order.seed}", quiet=quiet) as console:
        show = partial(show_run, console, interrupts, clock, started_s + WARM_UP_S)
        try:
            fold = run_goal(order, interrupts, clock, print_note, show)
        except PlaneEnded as error:
            if error.exit_code in {ExitCode.INVALID_INPUT, ExitCode.REJECTED}:
                raise Exit(ExitCode(error.exit_code), "\n".join(error.printed)) from error
            raise Exit(ExitCode.INTERNAL_ERROR, str(error).removeprefix(f"{error.code}: ")) from error
    code = ExitCode.INTERRUPTED if interrupts.count else compute_exit_code(fold)
    report = build_report(fold, workspace=fold.workspace.root, wall_s=clock.now_s() - started_s, exit_code=code)
    if as_json:
        print_json(report)
    print_report(report, fold, CleanConsole(stderr=as_json, highlight=False))
    return int(code)


def show_run(console: RunConsole, interrupts: Interrupts, clock: Clock, warm_by_s: float, fold: RunFold) -> None:
    """Bring the view up to date."""
    console.show(fold)
    print_stop(fold.workspace, console)
    has_moved = any(row.sim_time_s or (row.beat is not None and row.beat.tick) for row in fold.rows())
    if clock.now_s() > warm_by_s and not has_moved:
        console.print_once("warming up: a first run compiles its kernels; `paos doctor --warm` does so ahead")
    if interrupts.count:
        console.print_once("cancelling: the robot is being halted. Ctrl-C again ends at once.", "yellow")


def print_stop(workspace: Workspace, console: RunConsole) -> None:
    """Print why nothing moves under a latched emergency stop."""
    latch = read_latch(workspace.signals.parent)
    if latch is not None:
        why = f"emergency stop latched by {latch.by or '?'} ({latch.reason or 'no reason given'})"
        console.print_once(
            f"{why}; paos estop -w {workspace.root} --reset --reason ... lets it go on.", "red", even_quiet=True
        )
