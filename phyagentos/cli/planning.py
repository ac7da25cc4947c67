"""`paos plan`: from a goal without a plan to a goal graph, with its order and its reasons."""

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from phyagentos.assembly.project import get_file
from phyagentos.cli.language_models import (
    MODEL_URL,
    ModelAnswers,
    ModelCost,
    ModelPrice,
    ModelTime,
    ModelTokens,
    open_model,
)
from phyagentos.cli.outcome import ExitCode
from phyagentos.cli.reply import Reply
from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.plain_data import Fields

if TYPE_CHECKING:
    from phyagentos.agent.planning.answers import Step, Unsolvable
    from phyagentos.agent.planning.model_planner import ModelPlanner

_WORKSPACE = "Plan from what a run last observed, its ENVIRONMENT.md, rather than from the start of the scene."

_BY_MODEL = "Let the language model of the environment choose the steps; each is checked."
_PDDL = "Write a goal about amounts as domain.pddl and problem.pddl, for planners of others."


def plan(
    goal: Annotated[Path, typer.Argument(metavar="GOAL.yaml", help="A goal without a plan.")],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Write the goal graph to this file.")] = None,
    seed: Annotated[int, typer.Option(help="Of the scene's start.", min=0)] = 0,
    workspace: Annotated[Path | None, typer.Option("--workspace", "-w", help=_WORKSPACE)] = None,
    mermaid: Annotated[bool, typer.Option("--mermaid", help="The order as a Mermaid flowchart.")] = False,
    pddl: Annotated[Path | None, typer.Option("--pddl", metavar="DIR", help=_PDDL)] = None,
    by_model: Annotated[bool, typer.Option("--by-model", help=_BY_MODEL)] = False,
    model_answers: ModelAnswers = None,
    model_time: ModelTime = 60.0,
    model_tokens: ModelTokens = 24_000,
    model_price: ModelPrice = 0.0,
    model_cost: ModelCost = 0.0,
) -> Reply[object]:
    """Plan a goal by the effects of skills: sessions, their order, and why; start nothing."""
    from phyagentos.operations import plan as planning

    file = get_file(goal, "goal_graphs")
    limits = {"time_s": model_time, "tokens": model_tokens, "price": model_price, "cost": model_cost}
    open_planner = partial(_open_planner, model_answers, limits) if by_model or model_answers else lambda *_: None
    kept = output.with_suffix(".answers.json") if by_model and output is not None else None
    found = planning.plan(file, seed=seed, workspace=workspace, open_model=open_planner, answers=kept)
    notes = [f"wrote {kept}"] if kept is not None else []
    if pddl is not None:
        written = planning.write_pddl_files(file, pddl, seed=seed, workspace=workspace)
        notes.append(f"wrote {' and '.join(map(str, written))}")
    if not isinstance(found, planning.PlannedGraph):
        return Reply(found, render_missing(found), notes, code=ExitCode.GOAL_NOT_MET)
    if output is not None and found.graph:
        output.write_text(found.graph, encoding="utf-8")
        notes.append(f"wrote {output}; next: paos run {output}")
    text = "\n".join(iter_plan(found.goal, found.objective, found.sessions, found.accept))
    return Reply(found, found.mermaid if mermaid and found.mermaid else text, notes, folds=not mermaid)


def _open_planner(answers: Path | None, limits: Fields, objective: str, scene: str) -> "ModelPlanner":
    from phyagentos.agent.planning.model_planner import ModelPlanner

    if (found := open_model(ModelPlanner, answers, objective, scene, limits)) is None:
        hint = "An OpenAI-compatible server: the address up to /v1, and PHYAGENTOS_MODEL."
        raise DefinitionError.of("INVALID_VALUE", MODEL_URL, "not set", "the address of a model", hint)
    return found


def iter_plan(goal: str, objective: str, sessions: "Sequence[Step]", accept: Sequence[str]) -> Iterator[str]:
    """Each session with its reasons."""
    yield f"{goal}: {objective}"
    for step in sessions:
        arguments = ", ".join(f"{key}={value}" for key, value in step.parameters.items())
        after = f"  after {', '.join(step.after)}" if step.after else ""
        yield f"  {step.name}: {step.skill}({arguments}) on {step.target}{after}"
        yield from (f"      because {reason}" for reason in step.reasons)
    if not sessions:
        yield "  is met already: no session is needed"
    yield from (f"  goal accepts {text}" for text in accept)


def render_missing(found: "Unsolvable") -> str:
    """What a goal without a plan lacks."""
    head = "there is no plan" if found.is_proven else "no plan was found"
    return "\n".join([head, *(f"  {each.lack}: {each.describe()}" for each in found.missing)])
