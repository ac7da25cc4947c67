"""Run a goal graph to its verdict: check it, make a workspace, start both planes as child processes, report.

This process commands nothing and judges nothing: it follows the journal like any reader, and an interrupt becomes a
record, as any tool could write.
"""

import contextlib
import math
import os
import select
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from html import escape
from pathlib import Path

import msgspec

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.graph import GoalGraph, read_goal_graph
from phyagentos.agent.mission.mission import choose_goal
from phyagentos.agent.mission.report import MissionReport
from phyagentos.agent.mission.report import build_report as build_mission_report
from phyagentos.assembly.graphics import require_graphics
from phyagentos.assembly.memory_choice import choose_memory
from phyagentos.assembly.paths import choose_folder, serve_alone
from phyagentos.assembly.planes import Plane, start_watch
from phyagentos.assembly.planted_faults import check_planted, find_unstruck
from phyagentos.assembly.project import admit_python, get_file, open_library, parse_overrides, read_limits
from phyagentos.assembly.skill_checks import check_arguments, check_skill
from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, ExecutionError, Problem, has_room
from phyagentos.operations.lint import FileKind, find_other_kind
from phyagentos.operations.progress import RunFold
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.capabilities.targets import SHARING, TargetProfile, find_driver_name, is_beside
from phyagentos.protocol.capabilities.trees import read_tree
from phyagentos.protocol.documents.schema import read_yaml
from phyagentos.protocol.sessions.evidence import PICTURE_AFTER, PICTURE_BEFORE
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.protocol.settings.perception import Prior, Sensing
from phyagentos.protocol.settings.runtime_contract import WorldMode
from phyagentos.protocol.settings.settings_files import declare
from phyagentos.protocol.settings.verification_mode import VerificationMode
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.faults import read_faults
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.runtime.models.sources import require_models
from phyagentos.store.admission import GOAL_PREFIX, GoalEvent
from phyagentos.store.journal import Entry, IllegalEvent, Journal, cancel_unheld
from phyagentos.store.watch import Watch

FOLLOW_PERIOD_S = 0.1  # ten pictures a second are enough for people
CANCEL_PATIENCE_S = 20.0  # then the planes are ended without waiting for their records
Show = Callable[[RunFold], object]


class RunRequest(msgspec.Struct, frozen=True, kw_only=True):
    """What is to run; see `paos run --help`."""

    graph: Path
    seed: int = 0
    workspace: Path | None = None
    faults: Path | None = None
    overrides: Sequence[str] | None = None
    pictures: bool = True
    world_mode: WorldMode | None = None
    verify: VerificationMode | None = None
    sense: Sensing | None = None
    prior: Prior | None = None
    memory: str | None = None
    speed: float | None = None
    trusts_python: bool = False
    asks: bool = False  # whether verdicts wait for a person

    def __post_init__(self) -> None:
        if self.speed is not None and not 0.0 < self.speed <= 1.0:
            raise DefinitionError.of("INVALID_VALUE", "--speed", f"{self.speed:g}", "a number above 0, at most 1")


class RunReport(msgspec.Struct, frozen=True, kw_only=True):
    """What `paos run --json` prints.

    Attributes:
        report: Version of this format.
        exit_code: 0 goal met, 1 not met, 3 rejected by preflight, 4 no verdict, 130 interrupted or cancelled.
        wall_s: From the request until both planes have ended [s].
        pictures: Session -> files, in the order in which the sessions ended.
    """

    report: int = 1
    exit_code: int
    workspace: str
    wall_s: float
    pictures: dict[str, tuple[str, ...]]
    goal: MissionReport | None
    unstruck_faults: tuple[str, ...] = ()

    def _repr_html_(self) -> str:
        goal = self.goal
        sessions = (
            [(each.id, each.state, each.verdict, each.cause) for each in goal.sessions] if goal is not None else []
        )
        rows = "".join(f"<tr><td>{'<td>'.join(map(escape, row))}" for row in sessions)
        title, verdict = (
            (goal.goal, f"{goal.verdict} {goal.reason}") if goal is not None else (self.workspace, "no goal")
        )
        return f"<p><b>{escape(title)}</b>: {escape(verdict)} ({self.wall_s:.1f} s)</p><table>{rows}</table>"


class PlaneEnded(ExecutionError):
    """A plane ended before the verdict; its exit code and the lines that it has printed say why.

    The goal is not over: another run in the same `workspace` continues it.
    """

    def __init__(self, plane: Plane) -> None:
        self.workspace = plane.log.parent.parent
        self.exit_code, self.printed = plane.find_exit_code(), plane.read_printed()
        last = self.printed[-1] if self.printed else "it printed nothing."
        if not self.printed and not has_room(plane.log.parent):
            last = "it printed nothing, and its disk is full: make room and run it again."
        message = f"the {plane.name} plane ended with code {self.exit_code}: {last} Log: {plane.log}"
        super().__init__("NOT_RUNNING", message)


class Interrupts:
    """Counts Ctrl-C instead of raising: the first asks, the second insists. A terminal that hangs up only asks."""

    def __init__(self) -> None:
        self.count = 0

    def _note(self, number: int, _: object) -> None:
        if number != signal.SIGHUP:
            self.count += 1
            return
        self.count = max(self.count, 1)  # both the kernel and the shell report it
        for descriptor in (1, 2):
            mute_if_gone(descriptor)

    @contextmanager
    def counted(self) -> Iterator["Interrupts"]:
        """Take over SIGINT, SIGTERM and, unless it is ignored (`nohup`), SIGHUP; outside the main thread none."""
        is_ignored = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
        numbers = (signal.SIGINT, signal.SIGTERM, *(() if is_ignored else (signal.SIGHUP,)))
        is_main = threading.current_thread() is threading.main_thread()
        before = {number: signal.signal(number, self._note) for number in numbers if is_main}
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


def run_goal(
    request: RunRequest,
    interrupts: Interrupts,
    clock: Clock,
    announce: Callable[[str], object] = lambda _: None,
    show: Show = lambda _: None,
) -> RunReport:
    """Run a goal graph to its verdict, and report how it ended.

    `announce` is called with what is trusted, then with where the run takes place; from then on `interrupts` are
    counted: the first cancels the goal, a second one ends the planes at once. `show` is called before they start, then
    with each look, always with the same fold, which is complete at the end.

    Raises DefinitionError with every problem, before anything is started; PlaneEnded.
    """
    started_s, graph = clock.now_s(), get_file(request.graph, "goal_graphs")
    faults = get_file(request.faults, "faults") if request.faults is not None else None
    root = request.workspace or choose_folder(Path("workspaces"), f"{graph.stem}-{request.seed}")
    admit_python(root, graph, is_trusted=request.trusts_python, announce=announce)
    require_graphics()
    compiled = check_request(graph, faults, parse_overrides(request.overrides), request.workspace, request.seed)
    workspace = Workspace.create(root, open_library(graph))
    with serve_alone(workspace, clock), interrupts.counted():
        declare(workspace.runtime_contract, world_mode=request.world_mode, speed=request.speed)
        declare(workspace.perception, sensing=request.sense, prior=request.prior)
        announce(f"workspace {root}\nmemory {choose_memory(workspace, graph, request.memory)}")
        with contextlib.closing(Journal(workspace.root, side=Side.OPERATOR, by="paos run", clock=clock)) as journal:
            ledger = journal.open_ledger()
            goal = choose_goal(f"{compiled.name}-{request.seed}", ledger, journal)
            fold = RunFold(workspace, goal, ledger)
            show(fold)
            targets = sorted({choice.target for choice in compiled.choices.values()})
            planes = start_planes(request, goal, graph, faults, workspace, targets)
            try:
                follow_run(fold, journal, planes, interrupts, clock, show)
            except PlaneEnded:
                planes[-1].kill()  # a signal to end would cancel the goal, which can be continued
                raise
            finally:
                for plane in reversed(planes):  # the agent first: what it still cancels needs the runtime
                    plane.stop(clock, is_urgent=lambda: interrupts.count > 1)
                fold.apply(journal.read_new())
                if fold.goal is not None and fold.goal.is_cancelled:
                    with contextlib.suppress(ExecutionError):  # a full disk: the next runtime ends them
                        cancel_unheld(goal, fold.ledger, journal)
    return build_report(fold, clock.now_s() - started_s, is_interrupted=interrupts.count > 0)


def build_report(fold: RunFold, wall_s: float, *, is_interrupted: bool = False) -> RunReport:
    """The whole run in one value, from journal and evidence alone."""
    goal, workspace = fold.goal, fold.workspace
    report = build_mission_report(goal, fold.ledger, round(wall_s, 3)) if goal is not None else None
    sessions = sorted((row.session for row in fold.rows() if row.session is not None), key=lambda each: each.updated_at)
    ids = [each.contract.id for each in sessions]
    pairs = {id: [workspace.evidence_of(id) / name for name in (PICTURE_BEFORE, PICTURE_AFTER)] for id in ids}
    pictures = {id: tuple(str(path) for path in pair if path.is_file()) for id, pair in pairs.items()}
    exit_code = report.exit_code if report is not None and report.verdict else 4
    return RunReport(
        exit_code=130 if is_interrupted else exit_code,
        workspace=str(workspace.root),
        wall_s=round(wall_s, 3),
        pictures={id: found for id, found in pictures.items() if found},
        goal=report,
        unstruck_faults=find_unstruck(workspace.root),
    )


def check_request(
    graph: Path, faults: Path | None, overrides: Mapping[str, str], workspace: Path | None = None, seed: int = 0
) -> GoalGraph:
    """The graph, once it, the scene, skills and models that it names, and the faults are in order.

    A simulator is loaded for robots and scenes of a project alone: those that ship are known to be sound.

    Ports of trees against leaves, and how the scene begins, are left to preflight. Raises DefinitionError with every
    problem.
    """
    problems = find_other_kind(graph, FileKind.GOAL_GRAPH)
    problems += find_other_kind(faults, FileKind.FAULTS) if faults is not None else []
    if problems:
        raise DefinitionError(problems)
    library = open_library(graph)
    try:
        if faults is not None:
            read_faults(faults)
    except DefinitionError as error:
        problems += error.problems
    try:
        compiled = read_goal_graph(graph, catalogue := Catalogue.read(library), overrides)
    except DefinitionError as error:
        raise DefinitionError([*error.problems, *problems]) from error
    try:
        for name in sorted({choice.target for choice in compiled.choices.values()}):
            require_models(profile := catalogue.targets[name], (file := library.get_target(name)).parent)
            named = file, library.get_scene(compiled.spec.scene)
            if find_driver_name(profile) == SHARING and not all(map(_is_shipped, named)):
                problems += _check_own(profile, file, compiled, catalogue, library, seed)
        problems += check_arguments(compiled, read_yaml(graph), catalogue, library)
        if faults is not None and not problems:
            problems += check_planted(faults, compiled, catalogue, library, workspace)
    except DefinitionError as error:
        problems += error.problems
    files = [library.get_skill(skill) for skill in sorted({choice.skill for choice in compiled.choices.values()})]
    if problems := [*(each for file in files for each in check_skill(file, open_library(file))), *problems]:
        raise DefinitionError(problems)
    return compiled


def _is_shipped(file: Path) -> bool:
    return any(file.is_relative_to(find_shipped_root() / folder) for folder in ("robots", "scenes"))


def _check_own(
    profile: TargetProfile, file: Path, graph: GoalGraph, catalogue: Catalogue, library: Library, seed: int
) -> list[Problem]:
    """What `paos robot check` finds of a project's robot, and whether all objects, all to be grasped, are out of reach.

    Nothing where the model is brought together with those that ship.
    """
    from phyagentos.runtime.execution.leaf_registry import read_registry
    from phyagentos.runtime.execution.tree_check import needs_grasp
    from phyagentos.runtime.motion.profile_checks import check_profile  # the solvers: only where they are needed
    from phyagentos.runtime.motion.reach_check import find_out_of_reach

    if is_beside(profile.model) and not (file.parent / profile.model).is_file():
        return []
    if not _is_shipped(file) and (problems := check_profile(file, read_limits(library, profile.target))):
        return problems
    trees, registry = {catalogue.skills[each.skill].tree for each in graph.choices.values()}, read_registry(library)
    if not all(tree and needs_grasp(read_tree(library.get_tree(tree)).root, library, registry) for tree in trees):
        return []
    objects = {body for node, (body, _) in graph.brought.items() if graph.choices[node].target == profile.target}
    scene = read_scene(library.get_scene(graph.spec.scene))
    return find_out_of_reach(profile, file, scene, objects, seed) if profile.base is None else []


def start_planes(
    request: RunRequest,
    goal: GoalId,
    graph: Path,
    faults: Path | None,
    workspace: Workspace,
    targets: Sequence[str] = (),
) -> list[Plane]:
    """Start the runtime first, and the processes of `targets`: it warms up while the agent compiles."""
    watch = start_watch(workspace, faults=faults, pictures=request.pictures, expected=targets)
    agent = [str(graph), "--workspace", str(workspace.root), "--seed", str(request.seed), "--goal", goal]
    agent += ["--ask"] if request.asks else []
    agent += ["--trust-python"]  # as admitted here
    agent += ["--verify", request.verify] if request.verify is not None else []
    agent += ["--memory", request.memory] if request.memory is not None else []
    agent += [part for override in request.overrides or () for part in ("--set", override)]
    return [watch, Plane("agent", agent, workspace.logs)]


def follow_run(
    fold: RunFold, journal: Journal, planes: list[Plane], interrupts: Interrupts, clock: Clock, show: Show
) -> None:
    """Follow the run until it is over: verdict, cancelled, or a plane that failed."""
    asked_at_s: float | None = None
    with Watch([journal.folder, fold.workspace.heartbeats]) as watch:
        while True:
            watch.wait(FOLLOW_PERIOD_S)
            ended = [each for each in planes if each.find_exit_code() is not None]  # before reading: nothing is missed
            fold.apply(journal.read_new())
            show(fold)
            if interrupts.count and asked_at_s is None:
                asked_at_s = clock.now_s()
                ask_for_end(fold, journal)
            is_quiet = not any(each.contract.goal == fold.id for each in fold.ledger.live_sessions())  # of others none
            if fold.goal is not None and (fold.goal.verdict or fold.goal.is_cancelled) and is_quiet:
                return
            is_patience_spent = interrupts.count > 1 or clock.now_s() > (asked_at_s or math.inf) + CANCEL_PATIENCE_S
            if asked_at_s is not None and (is_quiet or is_patience_spent):
                return
            if ended:
                raise PlaneEnded(ended[0])


def ask_for_end(fold: RunFold, journal: Journal) -> None:
    """Cancel the goal; its agent, or else the runtime, cancels the sessions. One without a goal has none."""
    goal = fold.goal
    if goal is not None and not goal.verdict and not goal.is_cancelled:
        body = {"reason": "interrupted by the operator"}
        with contextlib.suppress(IllegalEvent):  # the verdict came first
            journal.commit([Entry(f"{GOAL_PREFIX}{goal.id}", GoalEvent.GOAL_CANCELLED, body)])
