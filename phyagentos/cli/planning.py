"""`paos plan`: from a goal without a plan to a goal graph, with its order and its reasons."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from phyagentos.assembly.project import get_file, open_library
from phyagentos.cli.arguments import AsJson
from phyagentos.cli.outcome import ExitCode, print_json, print_note, print_result
from phyagentos.protocol.capabilities.library import Library

if TYPE_CHECKING:
    from phyagentos.agent.planning.planned import PlannedGoal, Unsolvable

_WORKSPACE = "Plan from what a run last observed, its ENVIRONMENT.md, rather than from the start of the scene."


def plan(
    goal: Annotated[Path, typer.Argument(metavar="GOAL.yaml", help="A goal without a plan.")],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Write the goal graph to this file.")] = None,
    seed: Annotated[int, typer.Option(help="Of the scene's start.", min=0)] = 0,
    workspace: Annotated[Path | None, typer.Option("--workspace", "-w", help=_WORKSPACE)] = None,
    mermaid: Annotated[bool, typer.Option("--mermaid", help="The order as a Mermaid flowchart.")] = False,
    as_json: AsJson = False,
) -> int:
    """Plan a goal by the effects of skills: sessions, their order, and why; start nothing."""
    from phyagentos.agent.planning.planned import Unsolvable, render_mermaid, write_graph

    path = get_file(goal, "goal_graphs")
    planned = plan_file(path, open_library(path), seed, workspace)
    if isinstance(planned, Unsolvable):
        print_json(planned) if as_json else print_missing(planned)
        return int(ExitCode.GOAL_NOT_MET)
    if output is not None and planned.steps:
        output.write_text(write_graph(planned), encoding="utf-8")
        print_note(f"wrote {output}; next: paos run {output}")
    if as_json:
        print_json({"goal": planned.wanted.goal, "targets": planned.roles, "sessions": planned.steps})
    elif mermaid:
        print_result(render_mermaid(planned))
    else:
        print_plan(planned)
    return int(ExitCode.GOAL_MET)


def plan_file(path: Path, library: Library, seed: int, workspace: Path | None) -> "PlannedGoal | Unsolvable":
    """The plan of a goal without one, from what a workspace last observed, else from the start of its scene."""
    from phyagentos.agent.goals.catalogue import Catalogue
    from phyagentos.agent.planning.domain import read_wanted
    from phyagentos.agent.planning.planned import plan_goal
    from phyagentos.assembly.scene_start import draw_start
    from phyagentos.protocol.documents.schema import read_text
    from phyagentos.protocol.workspace.workspace import Workspace
    from phyagentos.protocol.world.environment import read_environment

    catalogue = Catalogue.read(library)
    wanted = read_wanted(path, catalogue)
    if workspace is None:
        return plan_goal(wanted, catalogue, draw_start(library, wanted.scene, wanted.targets.values(), seed))
    known = Workspace.open(workspace).environment
    return plan_goal(wanted, catalogue, read_environment(read_text(known), str(known)))


def print_plan(planned: "PlannedGoal") -> None:
    """Each session with its reasons, on stdout."""
    print_result(f"{planned.wanted.goal}: {planned.wanted.objective}")
    for step in planned.steps:
        arguments = ", ".join(f"{key}={value}" for key, value in step.parameters.items())
        after = f"  after {', '.join(step.after)}" if step.after else ""
        print_result(f"  {step.name}: {step.skill}({arguments}) on {step.target}{after}")
        for reason in step.reasons:
            print_result(f"      because {reason}")
    if not planned.steps:
        print_result("  is met already: no session is needed")
    for text in planned.wanted.accept:
        print_result(f"  goal accepts {text}")


def print_missing(found: "Unsolvable") -> None:
    """What a goal without a plan lacks, on stdout."""
    print_result("there is no plan" if found.is_proven else "no plan was found")
    for each in found.missing:
        print_result(f"  {each.lack}: {each.describe()}")
