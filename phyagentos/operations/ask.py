"""A request in words becomes a goal, a plan and a goal graph in a file; what is open or missing comes back instead.

A request lives in the workspace of its run, in `requests/`: the graph, and beside it the goal that was understood.
"""

import contextlib
import itertools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import msgspec
import yaml

from phyagentos.agent.context.dialogue import write_answers
from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.spec import WantedGoal
from phyagentos.agent.planning.answers import Step, Unsolvable
from phyagentos.agent.planning.domain import read_wanted
from phyagentos.agent.planning.planned import plan_goal
from phyagentos.agent.understanding.embedded import EmbeddedUnderstander
from phyagentos.agent.understanding.examples import list_examples
from phyagentos.agent.understanding.inquiries import Answer, answer
from phyagentos.agent.understanding.model import ModelUnderstander
from phyagentos.agent.understanding.understanding import (
    OF_WORDS,
    Ambiguous,
    Impossible,
    Inquiry,
    InquiryKind,
    Question,
    RequestProblem,
    Understanding,
    Understood,
)
from phyagentos.agent.understanding.vocabulary import Vocabulary, find_robot
from phyagentos.assembly.paths import choose_folder
from phyagentos.assembly.project import open_library
from phyagentos.assembly.scene_start import draw_start
from phyagentos.errors import DefinitionError
from phyagentos.operations.lint import lint_file
from phyagentos.operations.plan import PlannedGraph, describe_plan
from phyagentos.operations.preview import write_preview
from phyagentos.operations.run import RunReport
from phyagentos.operations.why import why
from phyagentos.operations.workspaces import FOLDER, REQUESTS, find_workspaces, get_newest
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.placed_scenes import name_plain
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import read_text
from phyagentos.protocol.documents.seen_text import find_unseen
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import Environment, read_environment

GOAL_SUFFIX = ".goal.yaml"
FIRST_SCENE = "tabletop/cubes_and_trays"


class Asked(msgspec.Struct, frozen=True, kw_only=True):
    """What `paos ask --json` prints of a request that was understood and planned.

    Attributes:
        goal: As a goal without a plan.
        reasons: Which words became what.
        left_out: Objects that the request names and the goal leaves as they are, each with the missing place.
        unsaid: Words without an effect on the goal, as `carefully`.
        chosen: Objects that stand for `a cube` or `two of the cubes`, where the choice was left open.
        sessions: In an order that reaches the goal; empty where it is met already.
        mermaid: The graph as a flowchart.
        graph: Its file; None where the goal is met already.
        workspace: Of the run, where the request lives; None where it was written elsewhere.
        before: File of the earlier goal that *again* means, and whose scene is the default.
        report: Of the run; None where the plan was not approved.
        picture: File of the goal as a picture, where it was wanted.
        is_grounded: Whether words of the request name what it is about; else a model alone has chosen it.
    """

    understood: bool = True
    goal: Fields
    reasons: tuple[str, ...]
    left_out: Mapping[str, str]
    unsaid: tuple[str, ...]
    chosen: tuple[str, ...]
    sessions: tuple[Step, ...]
    mermaid: str
    graph: str | None
    workspace: str | None
    before: str | None
    report: RunReport | None = None
    picture: str | None = None
    is_grounded: bool = True


class NotUnderstood(msgspec.Struct, frozen=True, kw_only=True):
    """What `paos ask --json` prints of a request that leaves something open, or that cannot be met here.

    `examples` are requests that would be understood instead.
    """

    understood: bool = False
    questions: tuple[Question, ...] = ()
    lacks: tuple[RequestProblem, ...] = ()
    examples: tuple[str, ...] = ()


class Answered(msgspec.Struct, frozen=True, kw_only=True):
    """What `paos ask --json` prints of a question: the answer, its evidence, and the snapshot that both are of."""

    understood: bool = True
    question: str
    answer: str
    evidence: tuple[str, ...]
    source: str


def ask(
    request: str,
    *,
    scene: str | None = None,
    robot: str | None = None,
    answers: Mapping[str, str] | None = None,
    choose: Callable[[Question], str] | None = None,
    open_model: Callable[[str], ModelUnderstander | None] = lambda _: None,
    seed: int = 0,
    workspace: Path | None = None,
    output: Path | None = None,
    preview: bool = False,
    picture: Path | None = None,
) -> Asked | NotUnderstood | Unsolvable | Answered:
    """Make a goal of a request, plan it, and write its graph, or answer a question; run nothing.

    `scene` is that of the last request by default, else the only one of the project or that of the first example, and
    `robot` that of the scene's goal graphs. `answers` are those to questions, by key; `choose` answers any other one,
    where all have candidates. `open_model` gives a scene's model, for what the grammar does not know. Files go to the
    requests of `workspace`, a new one by default, or to `output`. With `preview` the goal is drawn into `picture`, a
    file beside the graph by default.

    Raises DefinitionError for an unknown scene or target, letters that are not seen, and a graph with problems.
    """
    _require_seen(request)
    catalogue = Catalogue.read(library := open_library())
    past = _read_past(workspace, scene, catalogue)
    vocabulary, world = _read_vocabulary(library, catalogue, [*past.values()], scene, robot, seed)
    model = open_model(vocabulary.scene)
    understood = _understand(request, vocabulary, model, dict(answers or {}), choose)
    if isinstance(understood, Inquiry):
        return _answer(understood, vocabulary, world, workspace)
    if isinstance(understood, Ambiguous | Impossible):
        return _describe_gap(understood, vocabulary, request)
    planned = plan_goal(goal := understood.goal, catalogue, world, may_hold=False)
    if isinstance(planned, Unsolvable):
        return planned
    plan = describe_plan(planned)
    if planned.steps and output is None:
        workspace = workspace or choose_folder(FOLDER, f"{goal.goal}-{seed}")
        output = _choose_place(workspace, library, goal.goal, plan.graph)
    graph = _write(plan, goal, output, request, model) if planned.steps and output is not None else None
    if preview:
        picture = picture or (graph.with_suffix(".png") if graph is not None else Path(f"{goal.goal}.png"))
        write_preview(goal, planned.steps, world, library, seed, picture)
    files = (graph, workspace, next(reversed(past), None), picture if preview else None)
    return _describe_goal(understood, plan, *files)


def _describe_goal(
    understood: Understood,
    plan: PlannedGraph,
    graph: Path | None,
    workspace: Path | None,
    before: Path | None,
    picture: Path | None,
) -> Asked:
    return Asked(
        goal=understood.goal.model_dump(mode="json"),
        reasons=understood.reasons,
        left_out=understood.left_out,
        unsaid=understood.unsaid,
        chosen=understood.chosen,
        is_grounded=understood.is_grounded,
        sessions=plan.sessions,
        mermaid=plan.mermaid,
        graph=str(graph) if graph is not None else None,
        workspace=str(workspace) if workspace is not None else None,
        before=str(before) if before is not None else None,
        picture=str(picture) if picture is not None else None,
    )


def _require_seen(request: str) -> None:
    if unseen := find_unseen(request.strip()):
        raise DefinitionError.of("INVALID_VALUE", "the request", ", ".join(unseen[:8]), "text that is seen as it is")


def _choose_place(workspace: Path, library: Library, goal: str, graph: str) -> Path:
    """A new file of a graph among the requests of a workspace, which is made."""
    Workspace.create(workspace, library)
    return _choose_file(workspace / REQUESTS, goal, graph)


def _describe_gap(found: Ambiguous | Impossible, vocabulary: Vocabulary, request: str) -> NotUnderstood:
    if isinstance(found, Ambiguous):
        return NotUnderstood(questions=found.questions)
    return NotUnderstood(lacks=found.lacks, examples=list_examples(vocabulary, request))


def _answer(inquiry: Inquiry, vocabulary: Vocabulary, start: Environment, workspace: Path | None) -> Answered:
    """The answer of what the given or newest workspace last observed of the scene; else of the scene's start."""
    world, source = start, "the start of the scene"
    for root in (*((workspace,) if workspace is not None else ()), *find_workspaces()):
        with contextlib.suppress(DefinitionError, OSError):  # nothing was observed there yet
            path = Workspace.open(root).environment
            known = read_environment(read_text(path), str(path))
            if name_plain(known.scene) == vocabulary.scene:
                world, source = known, f"{path}, at {known.time_s:.1f} s"
                break
    match inquiry.kind:
        case InquiryKind.WHY:
            lines = why(workspace or get_newest()[0]).explanation
            found = Answer(answer=lines[0], evidence=lines[1:])
        case InquiryKind.ABILITIES:
            found = Answer(answer="; ".join(list_examples(vocabulary, most=6)))
        case _:
            found = answer(inquiry, world)
    return Answered(question=inquiry.words, answer=found.answer, evidence=found.evidence, source=source)


def _read_vocabulary(
    library: Library,
    catalogue: Catalogue,
    past: Sequence[WantedGoal],
    scene: str | None,
    robot: str | None,
    seed: int,
) -> tuple[Vocabulary, Environment]:
    """Scene, robot and past goals, and the scene's start; what is not named is of the last goal, and of its graphs."""
    if robot is not None and robot not in catalogue.targets:
        raise DefinitionError.unknown("target", "--robot", robot, catalogue.targets)
    scene = scene or (past[-1].scene if past else _choose_scene(library))
    if scene not in catalogue.scenes:
        raise DefinitionError.unknown("scene", "--scene", scene, catalogue.scenes)
    graphs = [path for root in library.roots for path in sorted((root / "goal_graphs").glob("*.yaml"))]
    robot = robot or find_robot(catalogue, graphs, scene)
    world = draw_start(library, scene, [robot], seed)
    return Vocabulary.read(catalogue, scene, past, robot, world), world


def _choose_scene(library: Library) -> str:
    """The only scene of a project; where there is none or several, that of the first example."""
    own = [names for root in library.roots[:-1] if (names := Library((root,)).names_of_scenes())]
    return own[0][0] if own and len(own[0]) == 1 else FIRST_SCENE


def _read_past(workspace: Path | None, scene: str | None, catalogue: Catalogue) -> dict[Path, WantedGoal]:
    """Earlier goals by file, the latest last: those of the given workspace, else of the newest that has any."""
    for root in (*([workspace] if workspace is not None else ()), *find_workspaces()):
        past = dict[Path, WantedGoal]()
        for path in sorted((root / REQUESTS).glob(f"*{GOAL_SUFFIX}"), key=lambda path: path.stat().st_mtime_ns):
            with contextlib.suppress(DefinitionError):  # its scene or objects may have gone since
                past[path] = read_wanted(path, catalogue)
        if past := {path: goal for path, goal in past.items() if scene in (None, goal.scene)}:
            return past
    return {}


def _understand(
    request: str,
    vocabulary: Vocabulary,
    model: ModelUnderstander | None,
    answers: dict[str, str],
    choose: Callable[[Question], str] | None,
) -> Understanding:
    """The goal, once every question has its answer; a model is asked for what the grammar does not know."""
    while True:
        found = EmbeddedUnderstander().understand(request, vocabulary, answers)
        lacks = found.lacks if isinstance(found, Impossible) else ()
        if model is not None and lacks and OF_WORDS.issuperset(lack.kind for lack in lacks):
            wider = model.understand(request, vocabulary, answers)
            found = Impossible(lacks=lacks + wider.lacks) if isinstance(wider, Impossible) else wider
        questions = found.questions if isinstance(found, Ambiguous) else ()
        if not questions or choose is None or not all(question.candidates for question in questions):
            return found
        answers |= {question.key: choose(question) for question in questions}


def _choose_file(folder: Path, name: str, text: str) -> Path:
    """The file in a folder that holds this text already, else the first of its name that is free."""
    names = (folder / f"{name}{f'_{number}' if number > 1 else ''}.yaml" for number in itertools.count(1))
    return next(path for path in names if not path.exists() or path.read_text(encoding="utf-8") == text)


def _write(plan: PlannedGraph, goal: WantedGoal, graph: Path, request: str, model: ModelUnderstander | None) -> Path:
    """The graph, beside it the goal and a model's answers, as files; raises DefinitionError for a graph's problems."""
    graph.parent.mkdir(parents=True, exist_ok=True)
    graph.write_text(plan.graph, encoding="utf-8")
    if problems := lint_file(graph):
        raise DefinitionError(problems)
    wanted = goal.model_dump(mode="json", exclude_defaults=True)
    text = yaml.safe_dump(wanted, sort_keys=False, allow_unicode=True, width=1000)
    graph.with_suffix(GOAL_SUFFIX).write_text(text, encoding="utf-8")
    if model is not None and model.kept:
        write_answers(graph.with_suffix(".answers.json"), request, goal.scene, model)
    return graph
