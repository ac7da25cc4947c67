"""`paos run`: lint, a workspace, both planes as child processes, a live view until the verdict, a report.

This process commands nothing and judges nothing: it follows the journal like any reader, and Ctrl-C becomes a signal
file, as any tool could write.
"""

import contextlib
import inspect
import math
import os
import select
import shutil
import signal
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.graph import GoalGraph, read_goal_graph
from phyagentos.agent.mission.mission import choose_goal
from phyagentos.assembly.memory_choice import choose_memory
from phyagentos.assembly.paths import choose_folder, serve_alone
from phyagentos.assembly.planes import Plane, start_watch
from phyagentos.cli.arguments import (
    Overrides,
    TrustPython,
    admit_python,
    get_file,
    get_settings,
    open_library,
    parse_overrides,
)
from phyagentos.cli.console import CleanConsole, RunConsole, RunFold
from phyagentos.cli.lint import FileKind, find_other_kind, lint_file
from phyagentos.cli.outcome import Exit, ExitCode, print_json, print_note
from phyagentos.cli.planted_faults import iter_misses
from phyagentos.cli.report import build_report, compute_exit_code, print_report
from phyagentos.cli.running import FaultFile, Graph, Known, Mode, Seed, Sense, Verify, WhichMemory
from phyagentos.cli.stopping import cancel_unheld
from phyagentos.clock import Clock, SystemClock
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.sessions.estop import read_latch
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.protocol.settings.perception import declare_sensing
from phyagentos.protocol.settings.runtime_contract import declare_world_mode
from phyagentos.protocol.settings.sensors import read_sensors
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.runtime.models.sources import require_models
from phyagentos.store.admission import GOAL_PREFIX, GoalEvent
from phyagentos.store.journal import Entry, IllegalEvent, Journal
from phyagentos.store.watch import Watch

VIEW_PERIOD_S = 0.1  # ten pictures a second are enough for people
FULL_BYTES = 1 << 20  # with less room than that no plane can keep its records
WARM_UP_S = 5.0  # a machine that has compiled its kernels moves before
CANCEL_PATIENCE_S = 20.0  # then the planes are ended without waiting for their records
_FOLDER_HELP = "Folder of the run; a new one under workspaces/ by default."


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
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


class Interrupts:
    """Counts Ctrl-C instead of raising: the first asks, the second insists. A terminal that hangs up only asks."""

    def __init__(self) -> None:
        self.count = 0

    @contextmanager
    def counted(self) -> Iterator["Interrupts"]:
        """Take over SIGINT, SIGTERM and, unless it is ignored (`nohup`), SIGHUP while the block runs."""

        def note(*_: object) -> None:
            self.count += 1

        def ask(*_: object) -> None:
            self.count = max(self.count, 1)  # both the kernel and the shell report it
            for descriptor in (1, 2):
                mute_if_gone(descriptor)

        handlers = {signal.SIGINT: note, signal.SIGTERM: note, signal.SIGHUP: ask}
        if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
            del handlers[signal.SIGHUP]
        before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
        try:
            yield self
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


def mute_if_gone(descriptor: int) -> None:
    """Let what is written to a terminal that has hung up go nowhere, instead of failing."""
    poll = select.poll()
    poll.register(descriptor, 0)  # POLLHUP is always reported
    if poll.poll(0):
        with Path(os.devnull).open("wb") as nowhere:
            os.dup2(nowhere.fileno(), descriptor)


def run_mission(order: Order) -> int:
    """Run a goal graph to its verdict; raises DefinitionError before anything is started, Exit when a plane failed."""
    clock, graph = SystemClock(), get_file(order.graph, "goal_graphs")
    faults = get_file(order.faults, "faults") if order.faults is not None else None
    compiled = lint_order(graph, faults, parse_overrides(order.overrides), order.workspace)
    root = order.workspace or choose_folder(Path("workspaces"), f"{graph.stem}-{order.seed}")
    admit_python(root, graph, is_trusted=order.trusts_python)
    workspace = Workspace.create(root, open_library(graph))
    with serve_alone(workspace, clock), Interrupts().counted() as interrupts:
        if order.world_mode is not None:
            declare_world_mode(workspace.runtime_contract, order.world_mode)
        declare_sensing(workspace.perception, order.sense, order.prior)
        started_s = clock.now_s()
        memory = choose_memory(workspace, graph, order.memory)
        print_note(f"workspace {root}\nmemory {memory}")  # from now on there is something to interrupt
        fold = run_planes(order, f"{compiled.name}-{order.seed}", graph, faults, workspace, interrupts, clock)
    code = ExitCode.INTERRUPTED if interrupts.count else compute_exit_code(fold)
    report = build_report(fold, workspace=root, wall_s=clock.now_s() - started_s, exit_code=code)
    if order.as_json:
        print_json(report)
    print_report(report, fold, CleanConsole(stderr=order.as_json, highlight=False))
    return int(code)


def run_planes(
    order: Order,
    name: str,
    graph: Path,
    faults: Path | None,
    workspace: Workspace,
    interrupts: Interrupts,
    clock: Clock,
) -> RunFold:
    """Both planes, from their start to their end; what stands in the journal then about the goal of this name."""
    journal = Journal(workspace.root, side=Side.OPERATOR, by="paos run", clock=clock)
    ledger = journal.open_ledger()
    for record in journal.read_new():
        ledger.apply(record)
    goal = choose_goal(name, ledger, journal)
    fold = RunFold(workspace.heartbeats, goal, ledger)
    with RunConsole(f"{graph.stem}, seed {order.seed}", quiet=order.quiet) as console:
        print_stop(workspace, console)
        planes = start_planes(order, goal, graph, faults, workspace)
        try:
            follow_run(fold, journal, workspace, planes, interrupts, console, clock)
        finally:
            for plane in reversed(planes):  # the agent first: what it still cancels needs the runtime
                plane.stop(clock, is_urgent=lambda: interrupts.count > 1)
            fold.apply(journal.read_new())
            if fold.goal is not None and fold.goal.is_cancelled:
                with contextlib.suppress(ExecutionError):  # a full disk: the next runtime ends them
                    cancel_unheld(goal, fold.ledger, journal)
            journal.close()
    return fold


def lint_order(
    graph: Path, faults: Path | None, overrides: Mapping[str, str], workspace: Path | None = None
) -> GoalGraph:
    """The graph, once it, the scene, skills and models that it names, and the faults are in order; loads no simulator.

    Ports of trees against leaves, and how the scene begins, are left to preflight. Raises DefinitionError with every
    problem.
    """
    library = open_library(graph)
    if problems := find_other_kind(graph, FileKind.GOAL_GRAPH):
        raise DefinitionError(problems)
    if faults is not None:
        problems = find_other_kind(faults, FileKind.FAULTS) or lint_file(faults)
    try:
        compiled = read_goal_graph(graph, catalogue := Catalogue.read(library), overrides)
    except DefinitionError as error:
        raise DefinitionError([*error.problems, *problems]) from error
    try:
        for name in sorted({choice.target for choice in compiled.choices.values()}):
            require_models(catalogue.targets[name], library.get_target(name).parent)
        bodies = read_scene(library.get_scene(compiled.spec.scene)).bodies
        if faults is not None and not problems:
            targets = {catalogue.targets[choice.target] for choice in compiled.choices.values()}
            joints = {joint for target in targets for joint in target.arm.joints}
            sensors = get_settings("sensors.yaml", library, workspace)
            cameras = read_sensors(sensors).cameras if sensors is not None else None
            problems += iter_misses(faults, bodies, joints, cameras)
    except DefinitionError as error:
        problems += error.problems
    files = [library.get_skill(skill) for skill in sorted({choice.skill for choice in compiled.choices.values()})]
    if problems := [*(problem for file in files for problem in lint_file(file)), *problems]:
        raise DefinitionError(problems)
    return compiled


def start_planes(order: Order, goal: GoalId, graph: Path, faults: Path | None, workspace: Workspace) -> list[Plane]:
    """Start the runtime first: it warms up while the agent compiles."""
    watch = start_watch(workspace, faults=faults, pictures=order.pictures)
    agent = [str(graph), "--workspace", str(workspace.root), "--seed", str(order.seed), "--goal", goal]
    agent += ["--verify", order.verify] if order.verify is not None else []
    agent += ["--memory", order.memory] if order.memory is not None else []
    agent += [part for override in order.overrides or () for part in ("--set", override)]
    return [watch, Plane("agent", agent, workspace.logs)]


def follow_run(
    fold: RunFold,
    journal: Journal,
    workspace: Workspace,
    planes: list[Plane],
    interrupts: Interrupts,
    console: RunConsole,
    clock: Clock,
) -> None:
    """Show the run until it is over: verdict, cancelled, or a plane that failed."""
    asked_at_s: float | None = None
    warm_by_s = clock.now_s() + WARM_UP_S
    with Watch([journal.folder, workspace.heartbeats]) as watch:
        while True:
            watch.wait(VIEW_PERIOD_S)
            ended = [
                plane for plane in planes if plane.find_exit_code() is not None
            ]  # before reading: nothing is missed
            fold.apply(journal.read_new())
            console.show(fold)
            print_stop(workspace, console)
            has_moved = any(row.sim_time_s or (row.beat is not None and row.beat.tick) for row in fold.rows())
            if clock.now_s() > warm_by_s and not has_moved:
                console.print_once("warming up: a first run compiles its kernels; `paos doctor --warm` does so ahead")
            if interrupts.count and asked_at_s is None:
                asked_at_s = clock.now_s()
                console.print_line("cancelling: the robot is being halted. Ctrl-C again ends at once.", "yellow")
                ask_for_end(fold, journal)
            is_quiet = not has_live(fold)
            if fold.goal is not None and (fold.goal.verdict or fold.goal.is_cancelled) and is_quiet:
                return
            is_patience_spent = interrupts.count > 1 or clock.now_s() > (asked_at_s or math.inf) + CANCEL_PATIENCE_S
            if asked_at_s is not None and (is_quiet or is_patience_spent):
                return
            if ended:
                raise_for(ended[0])


def has_live(fold: RunFold) -> bool:
    """Whether a session of the goal is live. What other goals have left is not waited for."""
    goal = fold.goal
    return goal is not None and any(each.contract.goal == goal.id for each in fold.ledger.live_sessions())


def print_stop(workspace: Workspace, console: RunConsole) -> None:
    """Print why nothing moves under a latched emergency stop."""
    latch = read_latch(workspace.signals.parent)
    if latch is not None:
        why = f"emergency stop latched by {latch.by or '?'} ({latch.reason or 'no reason given'})"
        console.print_once(
            f"{why}; paos estop -w {workspace.root} --reset --reason ... lets it go on.", "red", even_quiet=True
        )


def ask_for_end(fold: RunFold, journal: Journal) -> None:
    """Cancel the goal; its agent, or else the runtime, cancels the sessions. One without a goal has none."""
    goal = fold.goal
    if goal is not None and not goal.verdict and not goal.is_cancelled:
        body = {"reason": "interrupted by the operator"}
        try:
            journal.commit([Entry(f"{GOAL_PREFIX}{goal.id}", GoalEvent.GOAL_CANCELLED, body)])
        except IllegalEvent as error:  # the verdict came first
            print_note(str(error))


def raise_for(plane: Plane) -> None:
    """Raise Exit for a plane that ended before the verdict, with its own code where it is one of ours."""
    code = plane.find_exit_code()
    printed = plane.read_printed()
    if code in {ExitCode.INVALID_INPUT, ExitCode.REJECTED}:
        raise Exit(ExitCode(code), "\n".join(printed))
    last = printed[-1] if printed else "it printed nothing."
    if not printed and (room := shutil.disk_usage(plane.log.parent).free) < FULL_BYTES:
        last = f"it printed nothing, and its disk is full ({room} bytes are free): make room and run it again."
    raise Exit(ExitCode.INTERNAL_ERROR, f"the {plane.name} plane ended with code {code}: {last} Log: {plane.log}")
