"""Plan a goal that says what must come true by the effects of skills: a goal graph, or what is missing."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import msgspec

from phyagentos.agent.context.dialogue import write_answers
from phyagentos.agent.context.of_workspace import iter_sections
from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.spec import WantedGoal
from phyagentos.agent.planning.answers import Missing, PlannedGoal, Step, UnreachableReason, Unsolvable
from phyagentos.agent.planning.domain import read_wanted
from phyagentos.agent.planning.model_planner import ModelPlanner
from phyagentos.agent.planning.pddl import write_pddl
from phyagentos.agent.planning.planned import plan_goal, render_mermaid, write_graph
from phyagentos.agent.planning.recipe_domain import build_recipe_domain, is_of_amounts
from phyagentos.assembly.project import open_library
from phyagentos.assembly.scene_start import draw_start
from phyagentos.errors import DefinitionError
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.documents.schema import read_text
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import Environment, read_environment


class PlannedGraph(msgspec.Struct, frozen=True, kw_only=True):
    """What `paos plan --json` prints.

    Attributes:
        targets: Role -> target.
        sessions: In an order that reaches the goal; empty where it is met already.
        graph: The goal graph as YAML; empty without sessions, and so is `mermaid`, its flowchart.
    """

    goal: str
    objective: str
    targets: Mapping[str, str]
    sessions: tuple[Step, ...]
    accept: tuple[str, ...]
    graph: str
    mermaid: str


def plan(
    path: Path,
    *,
    seed: int = 0,
    workspace: Path | None = None,
    library: Library | None = None,
    open_model: Callable[[str, str], ModelPlanner | None] = lambda *_: None,
    answers: Path | None = None,
) -> PlannedGraph | Unsolvable:
    """The plan of a goal without one, from what a workspace last observed, else from the start of its scene.

    Skills and scenes are those of the project of `path`, or of a `library`. A model, which `open_model` gives for an
    objective and a scene, plans in place of the engine that ships; its answers are kept in `answers`. Raises
    DefinitionError with every problem.
    """
    wanted, catalogue, world = _read(path, seed, workspace, library)
    model = open_model(wanted.objective, wanted.scene)
    if model is None:
        planned = plan_goal(wanted, catalogue, world, may_hold=False)
        return planned if isinstance(planned, Unsolvable) else describe_plan(planned)
    if workspace is not None:
        place = Workspace.open(workspace)
        model = replace(model, known=(*iter_sections(place, read_ledger(workspace), None),))
    planned = plan_goal(wanted, catalogue, world, may_hold=False, solve=model.solve)
    if answers is not None:
        write_answers(answers, wanted.objective, wanted.scene, model)
    if isinstance(planned, Unsolvable):
        return Unsolvable((Missing(UnreachableReason.MODEL, names=tuple(model.refused)),), is_proven=False)
    return describe_plan(planned)


def write_pddl_files(path: Path, to: Path, *, seed: int = 0, workspace: Path | None = None) -> tuple[Path, Path]:
    """Write the problem of a goal about amounts as `domain.pddl` and `problem.pddl` into a folder; raises as `plan`."""
    wanted, catalogue, world = _read(path, seed, workspace, None)
    if not is_of_amounts(wanted):
        expected = "a goal about items, vitals or stations"
        raise DefinitionError.of("NO_CANDIDATE", f"{path}: accept", ", ".join(wanted.accept), expected)
    to.mkdir(parents=True, exist_ok=True)
    files = to / "domain.pddl", to / "problem.pddl"
    texts = write_pddl(build_recipe_domain(wanted, catalogue, world).problem, wanted.goal)
    for file, text in zip(files, texts, strict=True):
        file.write_text(text, encoding="utf-8")
    return files


def _read(
    path: Path, seed: int, workspace: Path | None, library: Library | None
) -> tuple[WantedGoal, Catalogue, Environment]:
    """The goal, what there is to reach it with, and the world that it is planned from."""
    library = library or open_library(path)
    catalogue = Catalogue.read(library)
    wanted = read_wanted(path, catalogue)
    if workspace is None:
        return wanted, catalogue, draw_start(library, wanted.scene, wanted.targets.values(), seed)
    known = Workspace.open(workspace).environment
    return wanted, catalogue, read_environment(read_text(known), str(known))


def describe_plan(planned: PlannedGoal) -> PlannedGraph:
    """A plan with its goal graph."""
    return PlannedGraph(
        goal=planned.wanted.goal,
        objective=planned.wanted.objective,
        targets=planned.roles,
        sessions=planned.steps,
        accept=planned.wanted.accept,
        graph=write_graph(planned) if planned.steps else "",
        mermaid=render_mermaid(planned) if planned.steps else "",
    )
