"""`paos ask`: a request in words becomes a goal, a plan, a goal graph in a file, and, once approved, a run."""

import contextlib
import io
import itertools
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from phyagentos.assembly.project import open_library
from phyagentos.cli.arguments import AsJson, TrustPython
from phyagentos.cli.outcome import Exit, ExitCode, print_json, print_note
from phyagentos.cli.planning import print_missing
from phyagentos.cli.running import NoPictures, Seed
from phyagentos.cli.understood import describe, print_open, put_questions, show
from phyagentos.errors import DefinitionError

if TYPE_CHECKING:
    from phyagentos.agent.goals.catalogue import Catalogue
    from phyagentos.agent.planning.planned import PlannedGoal
    from phyagentos.agent.understanding.model import ModelLimits, ModelUnderstander
    from phyagentos.agent.understanding.understanding import Understanding, Understood
    from phyagentos.agent.understanding.vocabulary import Vocabulary
    from phyagentos.assembly.mission_run import RunOrder
    from phyagentos.protocol.capabilities.library import Library

ASKED = Path("asked")  # goals and graphs of requests, below the working directory
WANTED_SUFFIX = ".goal.yaml"
MODEL_URL, MODEL, MODEL_KEY = "PHYAGENTOS_MODEL_URL", "PHYAGENTOS_MODEL", "PHYAGENTOS_MODEL_KEY"
_OUTPUT_HELP = "File of the goal graph; one named after the request below asked/ by default."
_ANSWER_HELP = "Answer to a question: its key, and one of its candidates. Repeatable."
_WORKSPACE_HELP = "Folder of the run; a new one under workspaces/ by default."


def ask(
    request: Annotated[str, typer.Argument(help="What is wanted, in English.")],
    scene: Annotated[str | None, typer.Option(help="Name of a scene; that of the last request by default.")] = None,
    robot: Annotated[str | None, typer.Option(help="A target; that of the scene's goal graphs by default.")] = None,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Approve the graph without being asked.")] = False,
    output: Annotated[Path | None, typer.Option("--output", "-o", help=_OUTPUT_HELP)] = None,
    answer: Annotated[list[str] | None, typer.Option(metavar="KEY=CANDIDATE", help=_ANSWER_HELP)] = None,
    model_answers: Annotated[Path | None, typer.Option(help="Use these answers of a model, and ask none.")] = None,
    model_time: Annotated[float, typer.Option(help="Longest wait for a model, all answers together [s].")] = 60.0,
    model_tokens: Annotated[int, typer.Option(help="Most tokens of all questions and answers.")] = 24_000,
    model_price: Annotated[float, typer.Option(help="Price of a million tokens.")] = 0.0,
    model_cost: Annotated[float, typer.Option(help="Most that a request may cost, at that price.")] = 0.0,
    mermaid: Annotated[bool, typer.Option("--mermaid", help="Show the graph as a Mermaid flowchart.")] = False,
    seed: Seed = 0,
    workspace: Annotated[Path | None, typer.Option("--workspace", "-w", help=_WORKSPACE_HELP)] = None,
    no_pictures: NoPictures = False,
    trust_python: TrustPython = False,
    as_json: AsJson = False,
) -> int:
    """Make a goal of a request in words, plan it, show the graph and, once approved, run it."""
    from phyagentos.agent.goals.catalogue import Catalogue
    from phyagentos.agent.understanding.model import ModelLimits
    from phyagentos.assembly.mission_run import RunOrder

    library = open_library()
    catalogue = Catalogue.read(library)
    vocabulary = _read_vocabulary(library, catalogue, scene, robot)
    limits = ModelLimits(time_s=model_time, tokens=model_tokens, price=model_price, cost=model_cost)
    model = _open_model(model_answers, request, vocabulary.scene, limits)
    understood = _understand(request, vocabulary, model, _parse_answers(answer or ()), as_json=as_json)
    if understood is None:
        return int(ExitCode.INVALID_INPUT)
    planned = _plan(library, catalogue, understood, seed, as_json=as_json)
    if planned is None:
        return int(ExitCode.GOAL_NOT_MET)
    graph = _write(request, understood, planned, output, model) if planned.steps else None
    if not as_json:
        show(understood, planned, mermaid=mermaid)
    if graph is not None:
        print_note(f"wrote {graph}")
        if yes or (not as_json and _is_approved()):
            pictures = not no_pictures
            order = RunOrder(
                graph=graph,
                seed=seed,
                workspace=workspace,
                pictures=pictures,
                trusts_python=trust_python,
            )
            return _run(understood, planned, order, as_json=as_json)
        print_note(f"not approved, nothing was run; next: paos run {graph}")
    if as_json:
        print_json(describe(understood, planned, graph))
    return int(ExitCode.GOAL_MET)


def _read_vocabulary(library: "Library", catalogue: "Catalogue", scene: str | None, robot: str | None) -> "Vocabulary":
    """Scene, robot and past goals; what is not named is that of the last request, and of the scene's graphs.

    Raises:
        DefinitionError: Scene or robot is unknown, or no scene is named.
    """
    from phyagentos.agent.planning.wanted_file import read_wanted
    from phyagentos.agent.understanding.vocabulary import Vocabulary, find_robot

    past = []
    for path in sorted(ASKED.glob(f"*{WANTED_SUFFIX}"), key=lambda path: path.stat().st_mtime_ns):
        with contextlib.suppress(DefinitionError):  # its scene or things may have gone since
            past.append(read_wanted(path, catalogue))
    scene = scene or (past[-1].scene if past else "")
    if robot is not None and robot not in catalogue.targets:
        raise DefinitionError.unknown("UNKNOWN_TARGET", "--robot", robot, catalogue.targets)
    graphs = [path for root in library.roots for path in sorted((root / "goal_graphs").glob("*.yaml"))]
    return Vocabulary.read(catalogue, scene, past, robot or find_robot(catalogue, graphs, scene))


def _open_model(
    answers: Path | None, request: str, scene: str, limits: "ModelLimits"
) -> "tuple[str, ModelUnderstander] | None":
    """Recorded answers, else the endpoint that the environment names, with its name; else none."""
    from phyagentos.agent.understanding.answers import replay_answers
    from phyagentos.agent.understanding.model import ModelUnderstander
    from phyagentos.clock import SystemClock
    from phyagentos.network.chat import OpenAiEndpoint

    if answers is not None:
        complete, name = replay_answers(answers, request, scene), str(answers)
    elif url := os.environ.get(MODEL_URL, ""):
        if not (model := os.environ.get(MODEL, "")):
            raise DefinitionError.of("INVALID_VALUE", MODEL, "not set", f"the name of a model at {MODEL_URL}")
        endpoint = OpenAiEndpoint(url=url, model=model, key=os.environ.get(MODEL_KEY, ""))
        complete, name = endpoint.complete, endpoint.name
    else:
        return None
    return name, ModelUnderstander(complete=complete, clock=SystemClock(), limits=limits)


def _parse_answers(texts: Sequence[str]) -> dict[str, str]:
    pairs = [text.rpartition("=") for text in texts]
    if wrong := [value for key, _, value in pairs if not key]:
        raise Exit(ExitCode.INVALID_INPUT, f"--answer {wrong[0]}: expected KEY=CANDIDATE")
    return {key: value for key, _, value in pairs}


def _understand(
    request: str,
    vocabulary: "Vocabulary",
    model: "tuple[str, ModelUnderstander] | None",
    answers: dict[str, str],
    *,
    as_json: bool,
) -> "Understood | None":
    """The goal, once every question has its answer; None where there is none, with what is missing printed."""
    from phyagentos.agent.understanding.embedded import EmbeddedUnderstander
    from phyagentos.agent.understanding.understanding import Ambiguous, Impossible, LackKind, Understood

    while True:
        found: Understanding = EmbeddedUnderstander().understand(request, vocabulary, answers)
        lacks = found.lacks if isinstance(found, Impossible) else ()
        if model is not None and lacks and all(lack.kind in {LackKind.WORD, LackKind.SENTENCE} for lack in lacks):
            wider = model[1].understand(request, vocabulary, answers)
            found = Impossible(lacks=lacks + wider.lacks) if isinstance(wider, Impossible) else wider
        if isinstance(found, Understood):
            return found
        is_asked = isinstance(found, Ambiguous) and all(question.candidates for question in found.questions)
        if not isinstance(found, Ambiguous) or as_json or not is_asked or not sys.stdin.isatty():
            print_open(found, as_json=as_json)
            return None
        answers |= put_questions(found)


def _plan(
    library: "Library", catalogue: "Catalogue", understood: "Understood", seed: int, *, as_json: bool
) -> "PlannedGoal | None":
    """The plan from the scene's start; None where there is none, with what is missing printed."""
    from phyagentos.agent.planning.planned import Unsolvable, plan_goal
    from phyagentos.assembly.scene_start import draw_start

    goal = understood.goal
    planned = plan_goal(goal, catalogue, draw_start(library, goal.scene, goal.targets.values(), seed))
    if isinstance(planned, Unsolvable):
        print_json(planned) if as_json else print_missing(planned)
        return None
    return planned


def _write(
    request: str,
    understood: "Understood",
    planned: "PlannedGoal",
    output: Path | None,
    model: "tuple[str, ModelUnderstander] | None",
) -> Path:
    """Goal, graph, and what a model answered, as files; raises DefinitionError where the graph has problems."""
    import yaml

    from phyagentos.agent.planning.graph_file import write_graph
    from phyagentos.agent.understanding.answers import write_answers
    from phyagentos.cli.lint import lint_file

    text = write_graph(planned)
    name = understood.goal.goal
    files = (ASKED / f"{name}{f'_{number}' if number > 1 else ''}.yaml" for number in itertools.count(1))
    graph = output or next(path for path in files if not path.exists() or path.read_text(encoding="utf-8") == text)
    for folder in (graph.parent, ASKED):
        folder.mkdir(parents=True, exist_ok=True)
    graph.write_text(text, encoding="utf-8")
    if problems := lint_file(graph):
        raise DefinitionError(problems)
    wanted = understood.goal.model_dump(mode="json", exclude_defaults=True)
    text = yaml.safe_dump(wanted, sort_keys=False, allow_unicode=True, width=1000)
    (ASKED / f"{graph.stem}{WANTED_SUFFIX}").write_text(text, encoding="utf-8")
    if model is not None and model[1].kept:
        file, scene = graph.with_suffix(".answers.json"), understood.goal.scene
        write_answers(file, request, scene, model[0], model[1].kept, model[1].shown)
    return graph


def _is_approved() -> bool:
    """A key press, where a person can press one."""
    if not sys.stdin.isatty():
        return False
    print_note("run it? [y/N]")
    return typer.getchar() in {"y", "Y"}


def _run(understood: "Understood", planned: "PlannedGoal", order: "RunOrder", *, as_json: bool) -> int:
    """As `paos run` does; its report becomes a part of this command's."""
    from phyagentos.cli.mission_run import run_mission

    if not as_json:
        return run_mission(order)
    with contextlib.redirect_stdout(io.StringIO()) as text:
        code = run_mission(order, as_json=True)
    print_json(describe(understood, planned, order.graph) | {"report": json.loads(text.getvalue())})
    return code
