"""`paos run`: a live view until the verdict, and a report."""

import contextlib
import getpass
import select
import sys
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from phyagentos.cli.arguments import AsJson, Overrides, TrustPython
from phyagentos.cli.console import CleanConsole, RunConsole
from phyagentos.cli.final_table import print_report
from phyagentos.cli.outcome import Exit, ExitCode, print_json, print_note
from phyagentos.cli.running import FaultFile, Graph, Known, Mode, NoPictures, Seed, Sense, Verify, WhichMemory
from phyagentos.clock import Clock, SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.operations.answer import OpenQuestion, iter_open, read_says, record
from phyagentos.operations.progress import RunFold
from phyagentos.operations.run import Interrupts, PlaneEnded, RunReport, RunRequest, run_goal
from phyagentos.protocol.sessions.estop import read_latch
from phyagentos.protocol.workspace.workspace import Workspace

WARM_UP_S = 6.0  # a machine that has compiled its kernels moves before
_FOLDER_HELP = "Folder of the run; a new one under workspaces/ by default."
_SPEED_HELP = "Share of the robots' speed limits, above 0 and up to 1; kept in runtime_contract.yaml."
RunFolder = Annotated[Path | None, typer.Option("--workspace", "-w", help=_FOLDER_HELP)]


def run(
    graph: Graph,
    seed: Seed = 0,
    workspace: RunFolder = None,
    faults: FaultFile = None,
    overrides: Overrides = None,
    as_json: AsJson = False,
    no_pictures: NoPictures = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Only the final table.")] = False,
    world_mode: Mode = None,
    verify: Verify = None,
    sense: Sense = None,
    prior: Known = None,
    memory: WhichMemory = None,
    speed: Annotated[float | None, typer.Option(help=_SPEED_HELP)] = None,
    trust_python: TrustPython = False,
) -> int:
    """Run a goal graph to its verdict: both planes, live progress, a final table."""
    request = RunRequest(
        graph=graph,
        seed=seed,
        workspace=workspace,
        faults=faults,
        overrides=overrides,
        pictures=not no_pictures,
        world_mode=world_mode,
        verify=verify,
        sense=sense,
        prior=prior,
        memory=memory,
        speed=speed,
        trusts_python=trust_python,
        asks=not quiet and not as_json and sys.stdin.isatty() and sys.stderr.isatty(),
    )
    report = run_shown(request, quiet=quiet, as_json=as_json)
    if as_json:
        print_json(report)
    return report.exit_code


def run_shown(request: RunRequest, *, quiet: bool = False, as_json: bool = False) -> RunReport:
    """Run with a live view and the final table, on stderr beside JSON; raises Exit when a plane failed."""
    clock, interrupts = SystemClock(), Interrupts()
    with RunConsole(f"{request.graph.stem}, seed {request.seed}", quiet=quiet) as console:
        show = partial(show_run, console, interrupts, clock, clock.now_s() + WARM_UP_S, asks=request.asks)
        try:
            report = run_goal(request, interrupts, clock, print_note, show)
        except PlaneEnded as error:
            if error.exit_code in {ExitCode.INVALID_INPUT, ExitCode.REJECTED}:
                raise Exit(ExitCode(error.exit_code), "\n".join(error.printed)) from error
            again = f"paos run {request.graph} --seed {request.seed} -w {error.workspace}"
            raise Exit(
                ExitCode.INTERNAL_ERROR, f"{error.message}\nThe goal is not over. Continue it: {again}"
            ) from error
    print_report(report, console.rows, CleanConsole(stderr=as_json, highlight=False))
    return report


def ask(console: RunConsole, workspace: Workspace, question: OpenQuestion) -> None:
    """Put a question on the terminal, once, and take the line that answers it, without waiting for one."""
    console.pause()
    pictures = "".join(f"\n  {each}" for each in question.pictures)
    console.print_once(f"{question.subject} asks: {question.question} yes or no?{pictures}", "bold")
    if not select.select([sys.stdin], [], [], 0.0)[0]:
        return
    if (truth := read_says(line := sys.stdin.readline())) is not None:
        with contextlib.suppress(DefinitionError):  # another terminal was faster
            record(workspace, question.subject, question.question, truth, getpass.getuser())
    elif line:
        console.print_line(f"{line.strip()!r} is neither yes nor no")


def show_run(
    console: RunConsole, interrupts: Interrupts, clock: Clock, warm_by_s: float, fold: RunFold, *, asks: bool = False
) -> None:
    """Bring the view up to date; under a latched emergency stop, say why nothing moves."""
    question = next((each for each in iter_open(fold.workspace, fold.ledger, fold.id) if not each.is_decided), None)
    if question is not None and asks and not interrupts.count:
        ask(console, fold.workspace, question)
        return
    console.show(fold)
    if (latch := read_latch(fold.workspace.signals.parent)) is not None:
        why = f"emergency stop latched by {latch.by or '?'} ({latch.reason or 'no reason given'})"
        way_out = f"paos estop -w {fold.workspace.root} --reset --reason ... lets it go on."
        console.print_once(f"{why}; {way_out}", "red", even_quiet=True)
    has_moved = any(row.sim_time_s or (row.beat is not None and row.beat.tick) for row in fold.rows())
    if clock.now_s() > warm_by_s and not has_moved:
        console.print_once("warming up: a busy machine, or kernels to compile (`paos doctor --warm` does so ahead)")
    if interrupts.count:
        console.print_once("cancelling: the robot is being halted. Ctrl-C again ends at once.", "yellow")
