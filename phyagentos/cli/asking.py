"""`paos ask`: a request in words, its questions, the graph that was made of it and, once approved, the run."""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import replace

from phyagentos.agent.planning.answers import Unsolvable
from phyagentos.agent.understanding.model import ModelUnderstander
from phyagentos.agent.understanding.understanding import Question
from phyagentos.cli.arguments import AsJson, TrustPython
from phyagentos.cli.exporting import draw_without_screen
from phyagentos.cli.language_models import ModelAnswers, ModelCost, ModelPrice, ModelTime, ModelTokens, open_model
from phyagentos.cli.mission_run import RunFolder, run_shown
from phyagentos.cli.outcome import Exit, ExitCode, print_found, print_json, print_note, print_result
from phyagentos.cli.planning import iter_plan, render_missing
from phyagentos.cli.running import NoPictures, Seed, WhichMemory
from phyagentos.operations import ask as asking
from phyagentos.operations.run import RunRequest

MOST_POSSIBLE = 8  # names in a line
_OUTPUT_HELP = "File of the goal graph; one among the requests of the run's workspace by default."
_PREVIEW_HELP = "Draw the goal as a picture: objects, and where each is to be; run nothing."
_PICTURE_HELP = "File of that picture; one beside the graph by default."
_SCENE_HELP = "By default that of the last request, the project or the first example."
_ANSWER_HELP = "Answer to a question: its key, and one of its candidates. Repeatable."


def ask(
    request: Annotated[str, typer.Argument(help="What is wanted, in English.")],
    scene: Annotated[str | None, typer.Option(help=_SCENE_HELP)] = None,
    robot: Annotated[str | None, typer.Option(help="A target; that of the scene's goal graphs by default.")] = None,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Approve the graph without being asked.")] = False,
    output: Annotated[Path | None, typer.Option("--output", "-o", help=_OUTPUT_HELP)] = None,
    answer: Annotated[list[str] | None, typer.Option(metavar="KEY=CANDIDATE", help=_ANSWER_HELP)] = None,
    model_answers: ModelAnswers = None,
    model_time: ModelTime = 60.0,
    model_tokens: ModelTokens = 24_000,
    model_price: ModelPrice = 0.0,
    model_cost: ModelCost = 0.0,
    mermaid: Annotated[bool, typer.Option("--mermaid", help="Show the graph as a Mermaid flowchart.")] = False,
    preview: Annotated[bool, typer.Option("--preview", help=_PREVIEW_HELP)] = False,
    picture: Annotated[Path | None, typer.Option(metavar="FILE.png", help=_PICTURE_HELP)] = None,
    seed: Seed = 0,
    workspace: RunFolder = None,
    no_pictures: NoPictures = False,
    memory: WhichMemory = None,
    trust_python: TrustPython = False,
    as_json: AsJson = False,
) -> int:
    """Make a goal of a request in words, plan it, show the graph and, once approved, run it."""
    preview = _prepare_preview(yes=yes) if preview or picture is not None else False
    limits = {"time_s": model_time, "tokens": model_tokens, "price": model_price, "cost": model_cost}
    found = asking.ask(
        request,
        scene=scene,
        robot=robot,
        answers=_parse_answers(answer or ()),
        choose=_put if sys.stdin.isatty() and not as_json else None,
        open_model=lambda place: open_model(ModelUnderstander, model_answers, request, place, limits),
        seed=seed,
        workspace=workspace,
        output=output,
        preview=preview,
        picture=picture,
    )
    if not isinstance(found, asking.Asked):
        return _show_without_goal(found, as_json=as_json)
    _show(found, mermaid=mermaid, as_json=as_json)
    is_approved = (yes and found.is_grounded) or (not as_json and not preview and _is_approved())
    if found.graph is None or not is_approved:
        return _end_without_run(found, yes=yes, as_json=as_json)
    into = Path(found.workspace) if found.workspace is not None else None
    run = RunRequest(graph=Path(found.graph), seed=seed, workspace=into, pictures=not no_pictures)
    report = run_shown(replace(run, memory=memory, trusts_python=trust_python), as_json=as_json)
    if as_json:
        print_json(replace(found, report=report))
    return report.exit_code


def _prepare_preview(*, yes: bool) -> bool:
    if yes:
        raise Exit(ExitCode.INVALID_INPUT, "--yes: runs the graph, which --preview does not; give one of them")
    draw_without_screen()
    return True


def _end_without_run(found: asking.Asked, *, yes: bool, as_json: bool) -> ExitCode:
    place = f" -w {found.workspace}" if found.workspace is not None else ""
    print_note(f"nothing was run; next: paos run {found.graph}{place}" if found.graph else "nothing is to be done")
    if as_json:
        print_json(found)
    if yes and not found.is_grounded:
        print_note("--yes approves no goal that a model alone has chosen: no word of the request names anything here")
        return ExitCode.INVALID_INPUT
    return ExitCode.GOAL_MET


def _show_without_goal(found: asking.Answered | asking.NotUnderstood | Unsolvable, *, as_json: bool) -> ExitCode:
    """An answer; questions with options that answer them, what is not known here, or what no skill makes true."""
    if isinstance(found, asking.Answered):
        lines = [found.answer, *(f"  {each}" for each in found.evidence), f"  as of {found.source}"]
        print_found(found, "\n".join(lines), as_json=as_json)
        return ExitCode.GOAL_MET
    if isinstance(found, Unsolvable):
        print_found(found, render_missing(found), as_json=as_json)
        return ExitCode.GOAL_NOT_MET
    print_found(found, "\n".join(_iter_open(found)), as_json=as_json)
    for question in () if as_json else found.questions:
        print_note(f"  --answer '{question.key}={question.likely or next(iter(question.candidates), '...')}'")
    return ExitCode.INVALID_INPUT


def _show(found: asking.Asked, *, mermaid: bool, as_json: bool) -> None:
    """What was understood and planned, and which files say so."""
    if not as_json:
        print_result("\n".join(_iter_goal(found, mermaid=mermaid)))
    if found.before is not None:
        print_note(f"the request before: {found.before}")
    if found.graph is not None:
        print_note(f"wrote {found.graph}")
    if found.picture is not None:
        print_note(f"wrote {found.picture}")


def _parse_answers(texts: Sequence[str]) -> dict[str, str]:
    pairs = [text.rpartition("=") for text in texts]
    if wrong := [value for key, _, value in pairs if not key]:
        raise Exit(ExitCode.INVALID_INPUT, f"--answer {wrong[0]}: expected KEY=CANDIDATE")
    return {key: value for key, _, value in pairs}


def _put(question: Question) -> str:
    print_note(f"{question.kind.told} {question.words!r}")
    for number, candidate in enumerate(question.candidates, 1):
        print_note(f"  {number}  {candidate}")
    number = 0
    while not 1 <= number <= len(question.candidates):
        number = typer.prompt("number", type=int, err=True)
    return question.candidates[number - 1]


def _is_approved() -> bool:
    """A key press, where a person can press one."""
    if not sys.stdin.isatty():
        return False
    print_note("run it? [y/N]")
    return typer.getchar() in {"y", "Y"}


def _iter_open(found: asking.NotUnderstood) -> Iterator[str]:
    """Each question with its candidates, or what is missing."""
    for question in found.questions:
        likely = f"; probably {question.likely}" if question.likely else ""
        yield f"{question.kind.told} {question.words!r}: {', '.join(question.candidates) or 'say it'}{likely}"
    for lack in found.lacks:
        near = f"; nearest is {lack.nearest!r}" if lack.nearest else ""
        possible = f"; possible: {', '.join(lack.possible[:MOST_POSSIBLE])}" if lack.possible else ""
        yield f"{lack.words!r} {lack.kind.told}{near}{possible}"

    if found.examples:
        yield f"understood here: {'; '.join(map(repr, found.examples))}"


def _iter_goal(found: asking.Asked, *, mermaid: bool) -> Iterator[str]:
    """The goal, what was left open or out, and the graph with its reasons."""
    goal = found.goal
    yield f"{goal['goal']}  in {goal['scene']}"
    yield from (f"  first   {', '.join(step)}" for step in goal["steps"])
    yield f"  wanted  {', '.join(goal['accept'])}"
    yield from [f"  always  {', '.join(goal['constraints'])}"] if goal["constraints"] else ()
    yield from (f"  LEFT OUT {name}, which stays where it is: there is no {of}" for name, of in found.left_out.items())
    yield from (f"  {word!r} changes nothing in this goal" for word in found.unsaid)
    yield from (f"  because {reason}" for reason in found.reasons)
    if mermaid and found.mermaid:
        yield found.mermaid
    else:
        yield from iter_plan(goal["goal"], goal["objective"], found.sessions, goal["accept"])
