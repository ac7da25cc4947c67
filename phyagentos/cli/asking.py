"""`paos ask`: a request in words becomes a goal, a plan, a goal graph in a file, and, once approved, a run."""

import contextlib
import io
import itertools
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.planning.domain import read_wanted
from phyagentos.agent.planning.planned import PlannedGoal, Unsolvable, plan_goal, render_mermaid, write_graph
from phyagentos.agent.understanding.embedded import EmbeddedUnderstander
from phyagentos.agent.understanding.model import ModelUnderstander, replay_answers, write_answers
from phyagentos.agent.understanding.understanding import (
    Ambiguous,
    Impossible,
    LackKind,
    Question,
    Understanding,
    Understood,
)
from phyagentos.agent.understanding.vocabulary import Vocabulary, find_robot
from phyagentos.assembly.project import open_library
from phyagentos.assembly.scene_start import draw_start
from phyagentos.cli import mission_run
from phyagentos.cli.arguments import AsJson, TrustPython
from phyagentos.cli.lint import lint_file
from phyagentos.cli.outcome import Exit, ExitCode, print_json, print_note, print_result
from phyagentos.cli.planning import print_missing, print_plan
from phyagentos.cli.running import NoPictures, Seed, WhichMemory
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.network.chat import OpenAiEndpoint
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
    memory: WhichMemory = None,
    trust_python: TrustPython = False,
    as_json: AsJson = False,
) -> int:
    """Make a goal of a request in words, plan it, show the graph and, once approved, run it."""
    library = open_library()
    catalogue = Catalogue.read(library)
    vocabulary = _read_vocabulary(library, catalogue, scene, robot)
    limits = {"time_s": model_time, "tokens": model_tokens, "price": model_price, "cost": model_cost}
    model = _open_model(model_answers, request, vocabulary.scene, limits)
    understood = _understand(request, vocabulary, model, _parse_answers(answer or ()), is_asked=not as_json)
    if not isinstance(understood, Understood):
        _print_open(understood, as_json=as_json)
        return int(ExitCode.INVALID_INPUT)
    goal = understood.goal
    planned = plan_goal(goal, catalogue, draw_start(library, goal.scene, goal.targets.values(), seed))
    if isinstance(planned, Unsolvable):
        print_json(planned) if as_json else print_missing(planned)
        return int(ExitCode.GOAL_NOT_MET)
    graph = _write(request, understood, planned, output, model) if planned.steps else None
    if not as_json:
        _show(understood, planned, mermaid=mermaid)
    if graph is not None:
        print_note(f"wrote {graph}")
        if yes or (not as_json and _is_approved()):
            order = mission_run.Order(graph=graph, seed=seed, workspace=workspace, as_json=as_json)
            order = replace(order, pictures=not no_pictures, memory=memory, trusts_python=trust_python)
            return _run(understood, planned, order)
        print_note(f"not approved, nothing was run; next: paos run {graph}")
    if as_json:
        print_json(_describe(understood, planned, graph))
    return int(ExitCode.GOAL_MET)


def _read_vocabulary(library: Library, catalogue: Catalogue, scene: str | None, robot: str | None) -> Vocabulary:
    """Scene, robot and past goals; what is not named is that of the last request, and of the scene's graphs."""
    past = []
    for path in sorted(ASKED.glob(f"*{WANTED_SUFFIX}"), key=lambda path: path.stat().st_mtime_ns):
        with contextlib.suppress(DefinitionError):  # its scene or things may have gone since
            past.append(read_wanted(path, catalogue))
    scene = scene or (past[-1].scene if past else "")
    if robot is not None and robot not in catalogue.targets:
        raise DefinitionError.unknown("UNKNOWN_TARGET", "--robot", robot, catalogue.targets)
    graphs = [path for root in library.roots for path in sorted((root / "goal_graphs").glob("*.yaml"))]
    return Vocabulary.read(catalogue, scene, past, robot or find_robot(catalogue, graphs, scene))


def _open_model(answers: Path | None, request: str, scene: str, limits: dict[str, Any]) -> ModelUnderstander | None:
    """Recorded answers, else the endpoint that the environment names; else none."""
    if answers is not None:
        complete, name = replay_answers(answers, request, scene), str(answers)
    elif url := os.environ.get(MODEL_URL, ""):
        if not (model := os.environ.get(MODEL, "")):
            raise DefinitionError.of("INVALID_VALUE", MODEL, "not set", f"the name of a model at {MODEL_URL}")
        endpoint = OpenAiEndpoint(url=url, model=model, key=os.environ.get(MODEL_KEY, ""))
        complete, name = endpoint.complete, endpoint.name
    else:
        return None
    return ModelUnderstander(name=name, complete=complete, clock=SystemClock(), **limits)


def _parse_answers(texts: Sequence[str]) -> dict[str, str]:
    pairs = [text.rpartition("=") for text in texts]
    if wrong := [value for key, _, value in pairs if not key]:
        raise Exit(ExitCode.INVALID_INPUT, f"--answer {wrong[0]}: expected KEY=CANDIDATE")
    return {key: value for key, _, value in pairs}


def _understand(
    request: str, vocabulary: Vocabulary, model: ModelUnderstander | None, answers: dict[str, str], *, is_asked: bool
) -> Understanding:
    """The goal, once every question has its answer; a model is asked for what the grammar does not know."""
    while True:
        found = EmbeddedUnderstander().understand(request, vocabulary, answers)
        lacks = found.lacks if isinstance(found, Impossible) else ()
        if model is not None and lacks and all(lack.kind in {LackKind.WORD, LackKind.SENTENCE} for lack in lacks):
            wider = model.understand(request, vocabulary, answers)
            found = Impossible(lacks=lacks + wider.lacks) if isinstance(wider, Impossible) else wider
        questions = found.questions if isinstance(found, Ambiguous) else ()
        is_asked = is_asked and sys.stdin.isatty() and all(question.candidates for question in questions)
        if not questions or not is_asked:
            return found
        answers |= {question.key: _put(question) for question in questions}


def _put(question: Question) -> str:
    print_note(f"{question.kind.told} {question.words!r}")
    for number, candidate in enumerate(question.candidates, 1):
        print_note(f"  {number}  {candidate}")
    number = 0
    while not 1 <= number <= len(question.candidates):
        number = typer.prompt("number", type=int, err=True)
    return question.candidates[number - 1]


def _write(
    request: str, understood: Understood, planned: PlannedGoal, output: Path | None, model: ModelUnderstander | None
) -> Path:
    """Goal, graph, and what a model answered, as files; raises DefinitionError where the graph has problems."""
    text, goal = write_graph(planned), understood.goal
    files = (ASKED / f"{goal.goal}{f'_{number}' if number > 1 else ''}.yaml" for number in itertools.count(1))
    graph = output or next(path for path in files if not path.exists() or path.read_text(encoding="utf-8") == text)
    for folder in (graph.parent, ASKED):
        folder.mkdir(parents=True, exist_ok=True)
    graph.write_text(text, encoding="utf-8")
    if problems := lint_file(graph):
        raise DefinitionError(problems)
    wanted = goal.model_dump(mode="json", exclude_defaults=True)
    text = yaml.safe_dump(wanted, sort_keys=False, allow_unicode=True, width=1000)
    (ASKED / f"{graph.stem}{WANTED_SUFFIX}").write_text(text, encoding="utf-8")
    if model is not None and model.kept:
        write_answers(graph.with_suffix(".answers.json"), request, goal.scene, model)
    return graph


def _is_approved() -> bool:
    """A key press, where a person can press one."""
    if not sys.stdin.isatty():
        return False
    print_note("run it? [y/N]")
    return typer.getchar() in {"y", "Y"}


def _run(understood: Understood, planned: PlannedGoal, order: mission_run.Order) -> int:
    """As `paos run` does; its report becomes a part of this command's."""
    if not order.as_json:
        return mission_run.run_mission(order)
    with contextlib.redirect_stdout(io.StringIO()) as text:
        code = mission_run.run_mission(order)
    print_json(_describe(understood, planned, order.graph) | {"report": json.loads(text.getvalue())})
    return code


def _print_open(found: Ambiguous | Impossible, *, as_json: bool) -> None:
    """Each question with its candidates and how a script answers it; or each thing that is missing."""
    if as_json:
        print_json({"understood": False} | asdict(found))
        return
    for question in found.questions if isinstance(found, Ambiguous) else ():
        candidates = ", ".join(question.candidates) or "say it"
        print_result(f"{question.kind.told} {question.words!r}: {candidates}")
        print_note(f"  --answer '{question.key}={next(iter(question.candidates), '...')}'")
    for lack in found.lacks if isinstance(found, Impossible) else ():
        near = f"; nearest is {lack.nearest!r}" if lack.nearest else ""
        possible = f"; possible: {', '.join(lack.possible)}" if lack.possible else ""
        print_result(f"{lack.words!r} {lack.kind.told}{near}{possible}")


def _show(understood: Understood, planned: PlannedGoal, *, mermaid: bool) -> None:
    """The goal, what was left open or out, and the graph with its reasons."""
    goal = understood.goal
    lines = [f"{goal.goal}  in {goal.scene}", *(f"  first   {', '.join(step)}" for step in goal.steps)]
    lines.append(f"  wanted  {', '.join(goal.accept)}")
    lines += [f"  always  {', '.join(goal.constraints)}"] if goal.constraints else []
    left_out = understood.left_out.items()
    lines += [f"  LEFT OUT {name}, which stays where it is: there is no {missing}" for name, missing in left_out]
    lines += [f"  no predicate says {word!r}; it changes nothing" for word in understood.unsaid]
    lines += [f"  because {reason}" for reason in understood.reasons]
    print_result("\n".join(lines))
    if mermaid and planned.steps:
        print_result(render_mermaid(planned))
    else:
        print_plan(planned)


def _describe(understood: Understood, planned: PlannedGoal, graph: Path | None) -> dict[str, Any]:
    goal, sessions = understood.goal.model_dump(mode="json"), [step.name for step in planned.steps]
    more = {"goal": goal, "sessions": sessions, "graph": str(graph) if graph is not None else None}
    return {"understood": True} | asdict(understood) | more
