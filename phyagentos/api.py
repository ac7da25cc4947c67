"""`import phyagentos as paos`: workspaces, goals and sessions for scripts and notebooks, and what the commands do.

A function that is called like a command returns what the command prints with `--json`, as a struct.
Views show what stood in documents and evidence when the workspace was opened; open it again for what came later. Each
function loads what it needs when it is called.
"""

import asyncio
from base64 import b64encode
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from html import escape
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, TypedDict, TypeVar, Unpack

from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError, ExecutionError, Problem
from phyagentos.protocol.sessions.evidence import TRAJECTORY, read_bundle
from phyagentos.protocol.sessions.session import GoalId, SessionId, SessionStatus
from phyagentos.protocol.sessions.strategy import Strategy
from phyagentos.protocol.sessions.tasks import GoalStatus
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.settings.perception import Prior, Sensing
from phyagentos.protocol.settings.runtime_contract import WorldMode
from phyagentos.protocol.settings.verification_mode import VerificationMode
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.history import fold_partition
from phyagentos.store.journal import choose_partition
from phyagentos.store.ledger import Ledger
from phyagentos.store.subjects import get_session

if TYPE_CHECKING:
    from phyagentos.agent.planning.answers import Unsolvable
    from phyagentos.bench.many import Runs
    from phyagentos.bench.summary import Comparison
    from phyagentos.operations.ask import Answered, Asked, NotUnderstood
    from phyagentos.operations.compile import CompiledGraph
    from phyagentos.operations.lint import LintReport
    from phyagentos.operations.plan import PlannedGraph
    from phyagentos.operations.run import RunReport
    from phyagentos.operations.status import WorkspaceStatus
    from phyagentos.operations.why import Explanation
    from phyagentos.pictures.playback import Array, Playback
    from phyagentos.pictures.trees import TickingNode

OptionT = TypeVar("OptionT", bound=StrEnum)


def open_workspace(path: str | Path) -> "WorkspaceView":
    """A workspace, before, during or after a run; raises `NOT_A_WORKSPACE`, `LEADS_OUT`, `JOURNAL_DAMAGED`."""
    place = Workspace.open(Path(path))
    ledger = fold_partition(place.sessions / choose_partition(place.sessions))
    children: dict[SessionId | None, list[SessionId]] = defaultdict(list)
    for id, status in ledger.sessions.items():
        children[status.contract.parent].append(id)
    sessions = {}
    for id, status in ledger.sessions.items():
        own, decided = status.contract, status.decision
        verdict, criteria = (decided.verdict.value, decided.criteria) if decided is not None else ("", ())
        kin, evidence = (own.parent, tuple(children[id])), place.evidence_of(id)
        sessions[id] = SessionView(id, own.node, status.state, verdict, criteria, own.strategy, *kin, evidence, status)
    goals = dict[str, GoalView]()
    for goal in ledger.goals.values():
        of_goal = tuple(sessions[id] for node in goal.nodes.values() for id in node.sessions if id in sessions)
        goals[goal.id] = GoalView(goal.id, goal.verdict, of_goal, place.root, goal)
    return WorkspaceView(place.root, goals, sessions, ledger)


def run(
    goal_graph: str | Path,
    *,
    seed: int = 0,
    workspace: str | Path | None = None,
    faults: str | Path | None = None,
    overrides: Mapping[str, object] | None = None,
    world_mode: str | None = None,
    verify: str | None = None,
    sense: str | None = None,
    prior: str | None = None,
    memory: str | None = None,
    speed: float | None = None,
    pictures: bool = True,
    trust_python: bool = False,
) -> "RunReport":
    """Run a goal graph to its verdict as `paos run` does, and report how it ended.

    `open_workspace(report.workspace)` shows everything else. An interrupt halts the robot, a second one ends at once.
    `goal_graph` and `faults` are files, or names of what ships; `overrides` are parameters by name, and roles as
    `targets.ROLE`. Everything else is as `paos run --help` says: without a `workspace` there is a new one.

    Raises DefinitionError with every problem, before anything is started; ExecutionError `NOT_RUNNING`; after an
    interrupt, once both planes have ended, KeyboardInterrupt.
    """
    from phyagentos.operations.run import Interrupts, RunRequest, run_goal

    request = RunRequest(
        graph=Path(goal_graph),
        seed=seed,
        workspace=_to_path(workspace),
        faults=_to_path(faults),
        overrides=_list_overrides(overrides),
        world_mode=_choose("world_mode", world_mode, WorldMode),
        verify=_choose("verify", verify, VerificationMode),
        sense=_choose("sense", sense, Sensing),
        prior=_choose("prior", prior, Prior),
        memory=memory,
        speed=speed,
        pictures=pictures,
        trusts_python=trust_python,
    )
    report = run_goal(request, interrupts := Interrupts(), SystemClock())
    if interrupts.count:
        raise KeyboardInterrupt
    return report


def run_many(
    goal_graph: str | Path,
    *,
    seeds: Iterable[int],
    folder: str | Path | None = None,
    jobs: int = 1,
    faults: str | Path | None = None,
    overrides: Mapping[str, object] | None = None,
    settings: Mapping[str, Mapping[str, object]] | None = None,
    world_mode: str | None = None,
    verify: str | None = None,
    sense: str | None = None,
    prior: str | None = None,
    speed: float | None = None,
    pictures: bool = True,
    progress: bool = True,
    ends: Event | None = None,
) -> "Runs":
    """Run a goal graph with every seed, each in a new workspace below `folder` and without memory of the others.

    Options are those of `run`; `settings` changes documents of each workspace, `{"runtime_contract.yaml":
    {"verification.mode": "audit"}}`. `jobs` runs go on side by side. What ended stays after an interrupt, or once
    another thread sets `ends`, and `open_runs(folder).resume()` carries out the rest.

    Raises DefinitionError with every problem before anything is started, `WOULD_OVERWRITE`; KeyboardInterrupt.
    """
    from phyagentos.bench import many
    from phyagentos.operations.run import RunRequest

    request = RunRequest(
        graph=Path(goal_graph),
        faults=_to_path(faults),
        overrides=_list_overrides(overrides),
        world_mode=_choose("world_mode", world_mode, WorldMode),
        verify=_choose("verify", verify, VerificationMode),
        sense=_choose("sense", sense, Sensing),
        prior=_choose("prior", prior, Prior),
        speed=speed,
        pictures=pictures,
    )
    if isinstance(seeds, int):
        raise DefinitionError.of(
            "INVALID_VALUE", "seeds", str(seeds), "several", f"Write range({seeds}), or [{seeds}]."
        )
    order = many.ManyRequest(run=request, seeds=tuple(seeds), folder=_to_path(folder), settings=settings or {})
    return many.run_many(order, jobs=jobs, ends=ends, shows=progress)


async def run_many_async(goal_graph: str | Path, *, seeds: Iterable[int], **options: "Unpack[ManyOptions]") -> "Runs":
    """As `run_many`, in a thread beside the event loop; a task that is cancelled leaves what has ended."""
    ends = Event()
    running = asyncio.ensure_future(asyncio.to_thread(run_many, goal_graph, seeds=seeds, ends=ends, **options))
    try:
        return await asyncio.shield(running)
    except asyncio.CancelledError:
        ends.set()
        await running
        raise


class ManyOptions(TypedDict, total=False):
    """Options of `run_many`."""

    folder: str | Path | None
    jobs: int
    faults: str | Path | None
    overrides: Mapping[str, object] | None
    settings: Mapping[str, Mapping[str, object]] | None
    world_mode: str | None
    verify: str | None
    sense: str | None
    prior: str | None
    speed: float | None
    pictures: bool
    progress: bool


def open_runs(folder: str | Path) -> "Runs":
    """What `run_many` or `paos bench run` has carried out so far; raises `NOT_A_WORKSPACE`."""
    from phyagentos.bench.many import Runs

    return Runs.open(Path(folder))


def compare(a: "Runs", b: "Runs") -> "Comparison":
    """Success of B against A, paired by seed, with McNemar's exact test; raises DefinitionError `INVALID_VALUE`."""
    from phyagentos.bench import many

    return many.compare(a, b)


def ask(
    request: str,
    *,
    scene: str | None = None,
    robot: str | None = None,
    answers: Mapping[str, str] | None = None,
    seed: int = 0,
    workspace: str | Path | None = None,
    output: str | Path | None = None,
) -> "Asked | NotUnderstood | Unsolvable | Answered":
    """Make a goal of a request in words, plan it and write its graph, without a model; nothing runs.

    `answers` are those to the questions of an earlier call, by their keys. Then `run(asked.graph, seed=seed,
    workspace=asked.workspace)`. Raises DefinitionError for an unknown scene or target.
    """
    from phyagentos.operations import ask as asking

    return asking.ask(
        request,
        scene=scene,
        robot=robot,
        answers=answers,
        seed=seed,
        workspace=_to_path(workspace),
        output=_to_path(output),
    )


def plan(goal: str | Path, *, seed: int = 0, workspace: str | Path | None = None) -> "PlannedGraph | Unsolvable":
    """Plan a goal that says what must come true, from the start of its scene, or as a workspace last observed it."""
    from phyagentos.assembly.project import get_file
    from phyagentos.operations import plan as planning

    return planning.plan(get_file(Path(goal), "goal_graphs"), seed=seed, workspace=_to_path(workspace))


def compile(goal_graph: str | Path, *, overrides: Mapping[str, object] | None = None) -> "CompiledGraph":
    """The sessions that a goal graph would make; raises DefinitionError with every problem."""
    from phyagentos.assembly.project import get_file, parse_overrides
    from phyagentos.operations.compile import compile_graph

    return compile_graph(get_file(Path(goal_graph), "goal_graphs"), parse_overrides(_list_overrides(overrides)))


def lint(*paths: str | Path, run_python: bool = False) -> "LintReport":
    """Check authored files and folders; every problem with file, line and column."""
    from phyagentos.bench.matrix import compile_suite
    from phyagentos.operations.lint import lint_paths

    return lint_paths(map(Path, paths), runs_python=run_python, check_suite=compile_suite)


def why(subject: str = "", *, workspace: str | Path | None = None) -> "Explanation":
    """Explain the verdict on a session, node or goal, the latest one without, of a workspace, the newest without.

    Raises `NOT_A_WORKSPACE`, `UNKNOWN_NAME`, `EVIDENCE_DAMAGED`.
    """
    from phyagentos.operations import why as explaining
    from phyagentos.operations.workspaces import get_newest

    return explaining.why(_to_path(workspace) or get_newest()[0], subject)


def status(workspace: str | Path | None = None) -> "WorkspaceStatus":
    """How a workspace stands, the newest without; raises `NOT_A_WORKSPACE`, `JOURNAL_DAMAGED`."""
    from phyagentos.operations.status import read_status
    from phyagentos.operations.workspaces import get_newest

    return read_status(_to_path(workspace) or get_newest()[0])


@dataclass(frozen=True, slots=True)
class Figure:
    """A drawing; `svg` stands alone, notebooks show it as an image, in which nothing runs, or else the `html`."""

    title: str
    svg: str = field(repr=False)
    html: str = field(default="", repr=False)

    def _repr_html_(self) -> str:
        data = b64encode(self.svg.encode()).decode()
        return self.html or f'<img alt="{escape(self.title)}" src="data:image/svg+xml;base64,{data}">'


@dataclass(frozen=True, slots=True)
class SessionView:
    """One attempt at one node of a goal; notebooks show its verdict.

    `verdict` is `success`, `replan`, `failure` or `unverified`, empty before, and `criteria` is what it rests on;
    `strategy` says what was to be done differently, and is false where nothing was; `children` replan this session;
    `evidence` is the folder of its bundle, there once it has run; `status` is all that the journal says of it.
    """

    id: SessionId
    node: str
    state: str
    verdict: str
    criteria: tuple[Criterion, ...] = field(repr=False)
    strategy: Strategy
    parent: SessionId | None
    children: tuple[SessionId, ...]
    evidence: Path = field(repr=False)
    status: SessionStatus = field(repr=False)

    @property
    def trajectory(self) -> "dict[str, Array]":
        """What was commanded and measured in n control periods of an arm with j joints, by name.

        `time_s` (n,) end of each period [s]; `q_commanded`, `q_measured` (n, j) positions [rad; m of a sliding joint];
        `qd_measured` (n, j) velocities [rad/s; m/s]; `gripper_commanded_m`, `gripper_measured_m` (n,) [m]; `force_n`
        (n,) greatest contact force [N], where the target feels one. Raises ExecutionError `EVIDENCE_DAMAGED`.
        """
        from phyagentos.protocol.workspace.array_files import read_arrays

        path = self.evidence / TRAJECTORY
        try:
            return read_arrays(path)
        except (OSError, ValueError) as error:
            raise ExecutionError("EVIDENCE_DAMAGED", f"{path}: {error}") from error

    @property
    def tree(self) -> Figure:
        """The behaviour tree of its skill, as HTML with how each node ended; raises `UNKNOWN_NAME` without one."""
        from phyagentos.pictures.trees import draw_tree, render_svg, tick
        from phyagentos.protocol.capabilities.skill_runtimes import read_skill
        from phyagentos.protocol.capabilities.trees import read_tree

        library = Workspace(self.evidence.parents[1]).library()
        name = read_skill(library.get_skill(self.status.contract.skill))[0].tree
        drawing, ran = draw_tree(read_tree(library.get_tree(name)), library), self.status.execution
        trace = read_bundle(self.evidence, self.status.contract, ran).trace if ran is not None else ()
        listed = _list_nodes(tick(drawing, trace), shows_all=not trace)
        return Figure(f"Behaviour tree {name}", render_svg(drawing), f"<ul>{listed}</ul>")

    def _repr_html_(self) -> str:
        decided = self.status.decision
        reason = f"{decided.cause} {decided.reason}" if decided is not None else self.status.reason
        return _show_verdict(self.id, self.verdict or self.state, reason, self.criteria)


@dataclass(frozen=True, slots=True)
class GoalView:
    """A goal; notebooks show its verdict and graph. `status` is all that the journal says of it."""

    id: GoalId
    verdict: str
    sessions: tuple[SessionView, ...] = field(repr=False)
    workspace: Path
    status: GoalStatus = field(repr=False)

    @property
    def graph(self) -> Figure:
        """Its nodes, with every attempt at them."""
        from phyagentos.pictures.goals import draw_goal

        return Figure(f"Graph of the goal {self.id}", draw_goal(self.status))

    def _repr_html_(self) -> str:
        return _show_verdict(self.id, self.verdict, self.status.reason, self.status.criteria) + self.graph._repr_html_()


@dataclass(frozen=True, slots=True)
class WorkspaceView:
    """Goals and sessions by id, in the order of their submission; iterates over its sessions."""

    root: Path
    goals: Mapping[str, GoalView] = field(repr=False)
    sessions: Mapping[SessionId, SessionView] = field(repr=False)
    _ledger: Ledger = field(repr=False)

    def _repr_html_(self) -> str:
        return "".join(goal._repr_html_() for goal in self.goals.values()) or f"<p>{escape(str(self.root))}</p>"

    def __iter__(self) -> Iterator[SessionView]:
        return iter(self.sessions.values())

    def __getitem__(self, session: str) -> SessionView:
        """The session; the part of its id after the goal is enough. Raises DefinitionError `UNKNOWN_NAME`."""
        return self.sessions[get_session(session, self.sessions)]

    def why(self, subject: str = "") -> str:
        """What `paos why` prints of a session, node or goal, or of the latest goal; raises `UNKNOWN_NAME`."""
        from phyagentos.operations.why import explain_subject

        return "\n".join(explain_subject(Workspace(self.root), self._ledger, subject).explanation)

    def replay(self, session: str) -> "Playback":
        """Its times, joint positions and tree over time, from evidence alone; raises `EVIDENCE_DAMAGED`."""
        from phyagentos.pictures.playback import read_playback

        return read_playback(Workspace(self.root), self[session].status)


def _to_path(given: str | Path | None) -> Path | None:
    return Path(given) if given is not None else None


def _list_overrides(given: Mapping[str, object] | None) -> list[str]:
    return [f"{name}={value}" for name, value in (given or {}).items()]


def _choose(name: str, value: str | None, options: type[OptionT]) -> OptionT | None:
    try:
        return options(value) if value is not None else None
    except ValueError:
        raise DefinitionError(Problem.unknown(name, name, str(value), options)) from None


def _show_verdict(title: str, verdict: str, reason: str, criteria: tuple[Criterion, ...]) -> str:
    """HTML; whatever is shown was written by others."""
    rows = "".join(
        f"<tr><td>{each.truth.mark}<td>{escape(each.kind)}<td><code>{escape(each.text)}</code><td>{escape(each.sentence)}"
        for each in criteria
    )
    return f"<p><b>{escape(title)}</b>: {escape(verdict)} {escape(reason)}</p><table>{rows}</table>"


def _list_nodes(node: "TickingNode", *, shows_all: bool) -> str:
    ended = node.event.status if node.event is not None else ""
    below = "".join(_list_nodes(each, shows_all=shows_all) for each in node.children) if ended or shows_all else ""
    return f"<li>{escape(node.drawing.label)} <b>{escape(ended)}</b><ul>{below}</ul>"
