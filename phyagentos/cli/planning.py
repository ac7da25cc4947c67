"""`paos plan`: from a goal without a plan to a goal graph, with its order and its reasons."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from phyagentos.assembly.project import get_file
from phyagentos.cli.outcome import ExitCode
from phyagentos.cli.reply import Reply

if TYPE_CHECKING:
    from phyagentos.agent.planning.answers import Step, Unsolvable

_WORKSPACE = "Plan from what a run last observed, its ENVIRONMENT.md, rather than from the start of the scene."

_PDDL = "Write a goal about amounts as domain.pddl and problem.pddl, for planners of others."


def plan(
    goal: Annotated[Path, typer.Argument(metavar="GOAL.yaml", help="A goal without a plan.")],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Write the goal graph to this file.")] = None,
    seed: Annotated[int, typer.Option(help="Of the scene's start.", min=0)] = 0,
    workspace: Annotated[Path | None, typer.Option("--workspace", "-w", help=_WORKSPACE)] = None,
    mermaid: Annotated[bool, typer.Option("--mermaid", help="The order as a Mermaid flowchart.")] = False,
    pddl: Annotated[Path | None, typer.Option("--pddl", metavar="DIR", help=_PDDL)] = None,
) -> Reply[object]:
    """Plan a goal by the effects of skills: sessions, their order, and why; start nothing."""
    from phyagentos.operations import plan as planning

    file = get_file(goal, "goal_graphs")
    found, notes = planning.plan(file, seed=seed, workspace=workspace), []
    if pddl is not None:
        written = planning.write_pddl_files(file, pddl, seed=seed, workspace=workspace)
        notes.append(f"wrote {' and '.join(map(str, written))}")
    if not isinstance(found, planning.PlannedGraph):
        return Reply(found, render_missing(found), notes, code=ExitCode.GOAL_NOT_MET)
    if output is not None and found.graph:
        output.write_text(found.graph, encoding="utf-8")
        notes.append(f"wrote {output}; next: paos run {output}")
    text = "\n".join(iter_plan(found.goal, found.objective, found.sessions, found.accept))
    return Reply(found, found.mermaid if mermaid and found.mermaid else text, notes)


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
