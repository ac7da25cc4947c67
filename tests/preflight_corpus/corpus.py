"""The corpus: one misconfiguration a YAML file, carried through lint, compilation and preflight as a run would be.

A case takes a goal graph that fits, edits one object, and names the codes that must come out, all of them and no other:

    name: velocity_wider_than_the_arm
    side: safety
    base: tidy_table                 # a goal graph of the library
    edits:
      - {file: protocol/safety.yaml, path: [targets, panda, joint_velocity_max, value], value: 3.0}
    expect: [LIMIT_INVALID (too wide)]

Files of the project are edited before anything reads them. Besides there are `SKILLRUNTIME.md` and `TARGETS.md` (a
block edited after the goal was compiled), `session` (every contract), `live` (what the target says of itself),
`world` (what is observed) and `policy` (what the policy server says).

Upstream: the folders beside this file. Downstream: the tests and benchmarks/preflight.py.
"""

import copy
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec
import yaml

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.compiler import SessionCompiler
from phyagentos.agent.goals.graph import read_goal_graph
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError, ExecutionError, Problem
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.capabilities.policy_descriptors import PolicyDescriptor
from phyagentos.protocol.capabilities.registries import read_skill_registry, read_target_registry
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.documents.document import split_front_matter
from phyagentos.protocol.sessions.session import GoalId, Scene, Session
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.descriptions import name_described
from phyagentos.protocol.world.environment import Environment
from phyagentos.runtime.execution.leaf_registry import build_registry
from phyagentos.runtime.motion.process import LocalPlanner, NoModel, Planner
from phyagentos.runtime.preflight.adapter_plan import AdapterPlan, TargetToolManifest, Trial
from phyagentos.runtime.preflight.compatibility import Preflight
from phyagentos.runtime.preflight.examination import Examiner
from phyagentos.runtime.preflight.settings import read_settings
from phyagentos.runtime.targets.wire import Description

from .recording import Recorded, read_recorded

HERE = Path(__file__).parent
LIBRARY = HERE / "library"
SIDES = ("contract", "target", "skill", "policy", "sensor", "safety", "graph")
OPEN = "${"
ROBOT = "panda"
KINDS = ("builtin", "policy")  # as if a policy loop shipped, so that nothing else hides behind its absence


class Edit(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One value put somewhere, or taken out.

    Attributes:
        file: Relative to the project, or one of the words above.
        path: Keys and indices.
        value: The new one.
        delete: Take out what is there instead.
    """

    file: str
    path: tuple[str | int, ...]
    value: Any = None
    delete: bool = False


class Case(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One file of the corpus.

    Attributes:
        name: Also the file's.
        side: Whose fault it is; also the folder's.
        base: Goal graph that fits.
        edits: What is done to it.
        expect: The codes, in any order.
        plans: Whether it needs the planner.
        kinds: Kinds of skills that the runtime can run.
    """

    name: str
    side: str
    base: str
    edits: tuple[Edit, ...]
    expect: tuple[str, ...]
    plans: bool = False
    kinds: tuple[str, ...] = KINDS


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What became of a case.

    Attributes:
        stage: `lint` or `preflight`, where it was refused; `granted` when nothing was found.
        problems: Every one.
        ms: What the examination of each session cost.
        plans: Of the sessions that fit.
        trials: Of all dry runs.
    """

    stage: str
    problems: tuple[Problem, ...] = ()
    ms: tuple[float, ...] = ()
    plans: tuple[tuple[AdapterPlan, TargetToolManifest], ...] = ()
    trials: tuple[Trial, ...] = ()

    @property
    def codes(self) -> set[str]:
        """Of the problems, with the kinds of unknown names."""
        return {problem.label for problem in self.problems}


def read_cases() -> list[Case]:
    """Every case, by side and name."""
    files = [file for side in SIDES for file in sorted((HERE / side).glob("*.yaml"))]
    return [read_case(file) for file in files]


def read_sound() -> list[Case]:
    """Edits that make nothing wrong, by name: these must be granted."""
    return [read_case(file) for file in sorted((HERE / "sound").glob("*.yaml"))]


def read_case(file: Path) -> Case:
    """One case; its name and side are those of its file."""
    case = msgspec.convert(_load(file.read_text(encoding="utf-8")), type=Case)
    assert (case.side, case.name) == (file.parent.name, file.stem), f"{file} says {case.side}/{case.name}"
    return case


@cache
def _open_shipped() -> tuple[TemporaryDirectory[str], Library]:
    """The corpus' own library before what ships, of whose robots only that of the recordings is kept: it reads fast."""
    folder = TemporaryDirectory(prefix="corpus-")
    for part in ("protocol", "skills", "trees", "scenes", "goal_graphs", f"robots/{ROBOT}"):
        shutil.copytree(find_shipped_root() / part, Path(folder.name) / "shipped" / part)
    return folder, Library((LIBRARY, Path(folder.name) / "shipped"))


@cache
def _prepare_unedited(base: str) -> tuple[Workspace, Sequence[Session]]:
    """What every case shares that edits no file."""
    folder, library = _open_shipped()
    workspace = Workspace.create(Path(folder.name) / base, library)
    return workspace, compile_sessions(base, library, workspace)


def make_project(folder: Path, edits: Sequence[Edit]) -> Library:
    """A project that holds the edited files, before the corpus' own library and what ships."""
    _, library = _open_shipped()
    for edit in edits:
        if edit.file in _EDITED_LATER:
            continue
        file = folder / edit.file
        if not file.exists():
            source = next(root / edit.file for root in library.roots if (root / edit.file).is_file())
            file.parent.mkdir(parents=True, exist_ok=True)
            for each in source.parent.iterdir() if source.parent.name != "goal_graphs" else (source,):
                if each.is_file() and (each == source or file.parent.parent.name in {"skills", "robots"}):
                    shutil.copyfile(each, file.parent / each.name)
        _edit_file(file, edit)
    return Library((folder, *library.roots)) if folder.exists() else library


def carry(case: Case, folder: Path, planner: Planner | None = None) -> Outcome:
    """Everything that a run does before the first command."""
    if {edit.file for edit in case.edits} <= _EDITED_LATER:
        return examine(case, *_prepare_unedited(case.base), planner)
    try:
        library = make_project(folder / "project", case.edits)
        workspace = Workspace.create(folder / "workspace", library)
        sessions = compile_sessions(case.base, library, workspace)
    except DefinitionError as error:
        return Outcome(stage="lint", problems=error.problems)
    return examine(case, workspace, sessions, planner)


def compile_sessions(name: str, library: Library, workspace: Workspace) -> list[Session]:
    """The first session of every node, without what only earlier ones can tell."""
    catalogue = Catalogue.of_workspace(workspace)
    file = next(root / "goal_graphs" / f"{name}.yaml" for root in library.roots if _has_graph(root, name))
    graph = read_goal_graph(file, catalogue)
    compiler = SessionCompiler(graph=graph, catalogue=catalogue, goal=GoalId(graph.name), seed=0)
    return [_settle(session) for session in compiler.preview()]


def examine(
    case: Case,
    workspace: Workspace,
    sessions: Sequence[Session],
    planner: Planner | None,
    *,
    recorded: Recorded | None = None,
    thorough: bool = True,
) -> Outcome:
    """Preflight of every session, each in the world as its scene begins.

    Args:
        case: Its edits of what is not a file.
        workspace: With the documents.
        sessions: As compiled.
        planner: None where no motion is tried.
        recorded: The world; by default the one that is kept.
        thorough: As `paos preflight` does it, not as a run.
    """
    recorded = recorded or read_recorded(sessions[0].scene.name)
    live = _edit(recorded.description, "live", case.edits)
    world = _edit(recorded.environment, "world", case.edits)
    target = sessions[0].target
    try:
        profile = _edit_model(read_target_registry(workspace.target_registry)[target], "TARGETS.md", case.edits)
        skills = {
            name: _edit_model(skill, "SKILLRUNTIME.md", case.edits)
            for name, skill in read_skill_registry(workspace.skill_registry).items()
        }
        settings = read_settings(workspace, target)
    except DefinitionError as error:
        return Outcome(stage="preflight", problems=error.problems)
    examiner = Examiner(
        preflight=Preflight(
            skills=skills, profile=profile, settings=settings, kinds=case.kinds, ask_policy=_make_server(skills, case)
        ),
        handle=RecordedHandle(live),  # type: ignore[arg-type]
        world=RecordedWorld(world),
        planner=planner or LocalPlanner(NoModel()),
        library=workspace.library(),
        registry=build_registry(workspace.library()),
        clock=SystemClock(),
    )
    findings = [
        examiner.examine(_edit(each, "session", case.edits), thorough=thorough and planner is not None)
        for each in sessions
    ]
    problems = tuple(problem for finding in findings for problem in finding.problems)
    return Outcome(
        stage="preflight" if problems else "granted",
        problems=problems,
        ms=tuple(finding.ms for finding in findings),
        plans=tuple((each.plan, each.tools) for each in findings if each.plan is not None and each.tools is not None),
        trials=tuple(trial for finding in findings for trial in finding.trials),
    )


class RecordedHandle:
    """A door behind which stands what a real world said; nothing can be commanded through it."""

    def __init__(self, live: Description) -> None:
        self._live = live

    def describe(self) -> Description:
        return self._live

    def load(self, scene: object, state: object = None, *, may_reset: bool = True) -> None:
        pass

    def observe(self) -> None:
        return None


class RecordedWorld:
    """Believes what was recorded."""

    def __init__(self, world: Environment) -> None:
        self._world = world

    def enter(self, scene: Scene) -> None:
        """One scene was recorded; its unnamed objects have the names that the goal gives them."""
        named = name_described(self._world.entities, scene.described)
        self._world = msgspec.structs.replace(self._world, entities=named)

    def observe(self, need: object) -> Environment:
        return self._world


_EDITED_LATER = {"session", "live", "world", "policy", "SKILLRUNTIME.md", "TARGETS.md"}


def _has_graph(root: Path, name: str) -> bool:
    return (root / "goal_graphs" / f"{name}.yaml").is_file()


def _load(text: str) -> Any:
    return yaml.load(text, Loader=yaml.CSafeLoader)


def _edit_text(text: str, edit: Edit) -> str:
    return yaml.dump(_apply(_load(text), [edit]), Dumper=yaml.CSafeDumper, sort_keys=False)


def _settle(session: Session) -> Session:
    given = {name: value for name, value in session.parameters.items() if OPEN not in str(value)}
    return msgspec.structs.replace(session, parameters=given)


def _make_server(skills: Mapping[str, SkillRuntime], case: Case) -> Any:
    """The policy server of a case: it says what SKILL.md says, but for the edits of `policy`."""
    edits = [edit for edit in case.edits if edit.file == "policy"]
    declared = next((skill.policy for skill in skills.values() if skill.policy is not None), None)

    def ask(endpoint: str) -> PolicyDescriptor:
        if any(edit.delete and not edit.path for edit in edits):
            raise ExecutionError("POLICY_UNREACHABLE", f"nobody listens at {endpoint}")
        assert declared is not None
        return PolicyDescriptor.model_validate(_apply(declared.model_dump(mode="json"), edits))

    return ask if edits else None


def _edit(value: Any, file: str, edits: Sequence[Edit]) -> Any:
    mine = [edit for edit in edits if edit.file == file]
    return msgspec.convert(_apply(msgspec.to_builtins(value), mine), type=type(value)) if mine else value


def _edit_model(model: Any, file: str, edits: Sequence[Edit]) -> Any:
    name = model.target if isinstance(model, TargetProfile) else model.skill
    mine = [
        msgspec.structs.replace(edit, path=edit.path[1:])
        for edit in edits
        if edit.file == file and edit.path[0] == name
    ]
    return type(model).model_validate(_apply(model.model_dump(mode="json", by_alias=True), mine)) if mine else model


def _edit_file(file: Path, edit: Edit) -> None:
    text = file.read_text(encoding="utf-8")
    if file.suffix == ".md":
        front, _ = split_front_matter(text, str(file))
        edited = _edit_text(front, edit)
        file.write_text(f"---\n{edited}---\n{text.split('---', 2)[2]}", encoding="utf-8")
    else:
        file.write_text(_edit_text(text, edit), encoding="utf-8")


def _apply(data: Any, edits: Sequence[Edit]) -> Any:
    data = copy.deepcopy(data)
    for edit in edits:
        owner = data
        for step in edit.path[:-1]:
            owner = owner.setdefault(step, {}) if isinstance(owner, dict) else owner[step]
        if edit.delete:
            del owner[edit.path[-1]]
        elif isinstance(owner, list) and edit.path[-1] == len(owner):
            owner.append(edit.value)
        else:
            owner[edit.path[-1]] = edit.value
    return data


RESCUED = {"clear_bench": {("clear_bench.carton-carry", "NOT_GRASPABLE")}}  # by design: another node runs instead


def iter_shipped() -> Iterator[str]:
    """Every goal graph that ships for the robot of the recordings, and the sound policy of the corpus."""
    shipped = sorted((find_shipped_root() / "goal_graphs").glob("*.yaml"))
    yield from (path.stem for path in shipped if "panda" in _load(path.read_text())["targets"].values())
    yield "follow"


def make_control(graph: str) -> Case:
    """A case without an edit, which must be granted."""
    return Case(name=f"{graph}_as_it_ships", side="graph", base=graph, edits=(), expect=())
