"""Compile a goal graph: the sessions that it would make, with what each waits for; starts nothing."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.graph import GoalGraph, read_goal_graph, render_mermaid
from phyagentos.assembly.project import open_library
from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.predicates.project_predicates import load_predicates, name_option


class CompiledNode(msgspec.Struct, frozen=True, kw_only=True):
    """The session of one node; `because` says why this skill and target, `rejected` why no other candidate."""

    node: str
    skill: str
    target: str
    parameters: Mapping[str, Any]
    after: tuple[str, ...]
    on_failure: tuple[tuple[str, ...], ...]
    accept: tuple[str, ...]
    because: tuple[str, ...]
    rejected: Mapping[str, str]


class CompiledGraph(msgspec.Struct, frozen=True, kw_only=True):
    """What `paos compile --json` prints; `parameters` are those of `--set`, `mermaid` is the DAG as a flowchart."""

    goal: str
    objective: str
    parameters: Mapping[str, Fields]
    sessions: tuple[CompiledNode, ...]
    accept: tuple[str, ...]
    mermaid: str


def compile_graph(
    path: Path, overrides: Mapping[str, str] | None = None, *, runs_python: bool = False
) -> CompiledGraph:
    """The sessions of a goal graph as its project has them; raises DefinitionError with every problem.

    Predicates of the project are executed only where it `runs_python`.
    """
    library = open_library(path)
    if runs_python:
        load_predicates(library.iter_predicates())
    try:
        return describe_graph(read_goal_graph(path, Catalogue.read(library), overrides))
    except DefinitionError as error:
        raise DefinitionError(name_option(error.problems, library.iter_predicates())) from error


def describe_graph(graph: GoalGraph) -> CompiledGraph:
    """The same of a graph that has been read."""
    return CompiledGraph(
        goal=graph.name,
        objective=graph.spec.objective,
        parameters={name: each.model_dump(mode="json") for name, each in graph.spec.parameters.items()},
        sessions=tuple(_describe_node(graph, name) for name in graph.order),
        accept=graph.spec.accept,
        mermaid=render_mermaid(graph),
    )


def _describe_node(graph: GoalGraph, name: str) -> CompiledNode:
    node, choice = graph.nodes[name], graph.choices[name]
    return CompiledNode(
        node=name,
        skill=choice.skill,
        target=choice.target,
        parameters=choice.parameters,
        after=tuple(node.after),
        on_failure=tuple(map(tuple, node.on_failure)),
        accept=tuple(node.spec.accept),
        because=choice.reasons,
        rejected=choice.rejected,
    )
