"""The goal graph: a checked DAG of nodes, each bound to a skill and a target. Paper sections 3.3 and 4.1."""

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

import networkx as nx

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.checks import Checks
from phyagentos.agent.goals.composition import Composer, as_dict
from phyagentos.agent.goals.expansion import Node, expand_nodes
from phyagentos.agent.goals.selector import Choice
from phyagentos.agent.goals.spec import GoalSpec
from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.capabilities.skill_runtimes import find_roles
from phyagentos.protocol.documents.flowchart import Arrow, Box, render_flowchart
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import Located, parse_yaml, read_yaml, salvage
from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.meaning import read_statement
from phyagentos.protocol.predicates.predicate import parse_predicate, substitute
from phyagentos.protocol.predicates.syntax import Name, iter_calls


@dataclass(frozen=True, slots=True, kw_only=True)
class GoalGraph:
    """One goal as a DAG.

    Attributes:
        spec: As authored, overrides applied, includes expanded.
        bundle: As authored, overrides applied, included graphs in their places; None where the file says the same.
        dag: Edges lead to the nodes that wait; the attribute `data` names the outputs that flow.
        order: Topological; authored order decides between nodes without an edge.
        brought: Node -> the object that it brings to a place, and the place.
        rescuers: Node -> nodes that run when it has failed.
        kept: Objects that are not moved to make room: some condition names them, and no node brings them anywhere.
        warnings: What may not be decided when it runs.
    """

    spec: GoalSpec
    source: str
    nodes: Mapping[str, Node]
    choices: Mapping[str, Choice]
    dag: "nx.DiGraph[str]"
    order: tuple[str, ...]
    brought: Mapping[str, tuple[str, str]]
    kept: tuple[str, ...]
    warnings: tuple[Problem, ...] = ()
    bundle: Any = None
    rescuers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the goal."""
        return self.spec.goal

    def find_coming(self, node: str) -> tuple[str, ...]:
        """Objects that other nodes bring to the place where this one brings something."""
        own, destination = self.brought.get(node, ("", ""))
        others = (item for item, place in self.brought.values() if place == destination and item != own)
        return tuple(dict.fromkeys(others))

    def max_replans(self, node: str) -> int:
        """Children that a node may have."""
        own = self.nodes[node].spec.max_replans
        return self.spec.defaults.max_replans if own is None else own


def read_goal_graph(path: Path, catalogue: Catalogue, overrides: Mapping[str, str] | None = None) -> GoalGraph:
    """Read and check a goal graph; a YAML value in `overrides` replaces the file's (`targets.arm` -> `panda`).

    Raises:
        DefinitionError: With every problem of the file.
    """
    graph, problems = _load(path, catalogue, overrides or {})
    if graph is None:
        raise DefinitionError(problems)
    return graph


def check_goal_graph(path: Path, catalogue: Catalogue) -> list[Problem]:
    """Every problem of a goal graph; empty when it can run."""
    return _load(path, catalogue, {})[1]


def render_mermaid(graph: GoalGraph) -> str:
    """The DAG as a Mermaid flowchart; data edges carry the names of their outputs, those on failure are dotted."""
    boxes = [
        Box(name=name, title=name, below=[f"{each.skill} on {each.target}"]) for name, each in graph.choices.items()
    ]
    arrows = [
        Arrow(before, after, "on failure" if facts["on_failure"] else ", ".join(facts["data"]), facts["on_failure"])
        for before, after, facts in graph.dag.edges(data=True)
    ]
    return render_flowchart(boxes, arrows, direction="LR")


def _load(path: Path, catalogue: Catalogue, overrides: Mapping[str, str]) -> tuple[GoalGraph | None, list[Problem]]:
    try:
        written = read_yaml(path)
        composed = Composer(override_yaml(written, overrides), catalogue)
    except DefinitionError as error:
        return None, list(error.problems)
    spec, problems = salvage(GoalSpec, located := composed.flat)
    problems = [*composed.problems, *problems]
    if spec is None:
        return None, problems
    problems += catalogue.problems
    nodes = expand_nodes(spec, located, problems, composed.groups)
    dag = _build_dag(nodes)
    failing = {each: () for node in nodes.values() for edge in node.on_failure for each in edge}
    rescuers = {each: tuple(n for n, node in nodes.items() if each in chain(*node.on_failure)) for each in failing}
    order = _sort(nodes, dag, rescuers, located, problems)
    checks = Checks(spec, nodes, located, catalogue)
    problems += checks.check_spec()
    choices, more = checks.check_bindings(dag, order)
    by_finding = {(problem.code, problem.address, problem.found): problem for problem in reversed([*problems, *more])}
    unique = list(reversed(by_finding.values()))
    if unique or len(choices) < len(nodes):
        return None, unique
    brought: dict[str, tuple[str, str]] = {}
    for name, choice in choices.items():
        item, place = (choice.parameters.get(key) for key in find_roles(catalogue.skills[choice.skill]))
        brought |= {name: (str(item), str(place))} if place and not nodes[name].is_open else {}
    graph = GoalGraph(
        spec=spec,
        source=located.source,
        nodes=nodes,
        choices=choices,
        dag=dag,
        order=order,
        brought=brought,
        kept=_find_kept(spec, nodes, choices, {item for item, _ in brought.values()}),
        warnings=tuple(checks.iter_warnings()),
        bundle=composed.bundle if composed.bundle != written.data else None,
        rescuers=rescuers,
    )
    return graph, []


def _sort(
    nodes: Mapping[str, Node],
    dag: "nx.DiGraph[str]",
    rescuers: Mapping[str, tuple[str, ...]],
    located: Located,
    problems: list[Problem],
) -> tuple[str, ...]:
    """The nodes in order, each after those that run when one that it waits for has failed; cycles go to `problems`."""
    order_dag = dag.copy()
    order_dag.add_edges_from((r, name) for name, node in nodes.items() for b in node.after for r in rescuers.get(b, ()))
    while not nx.is_directed_acyclic_graph(order_dag):
        edges = nx.find_cycle(order_dag)
        cycle = [*(edge[0] for edge in edges), edges[0][0]]
        hint = "Remove one of these edges."
        problems.append(located.problem("CYCLE", nodes[cycle[0]].path, " -> ".join(cycle), "no way back", hint))
        order_dag.remove_edge(cycle[-2], cycle[-1])  # only to find what else is wrong
    rank = {name: index for index, name in enumerate(nodes)}
    return tuple(nx.lexicographical_topological_sort(order_dag, key=rank.__getitem__))


def _find_kept(
    spec: GoalSpec, nodes: Mapping[str, Node], choices: Mapping[str, Choice], brought: set[str]
) -> tuple[str, ...]:
    at_last, always = [*spec.accept], [*spec.constraints]
    for name, node in nodes.items():
        values = choices[name].parameters
        always += [substitute(text, values) for text in (*node.spec.requires, *node.spec.hold)]
        at_last += [substitute(text, values) for text in node.spec.accept]
    free = {meaning for meaning in Meaning if meaning.holds_anywhere}
    terms = (
        term
        for texts, passed in ((always, free), (at_last, {*free, Meaning.HOLDING}))  # a hand lets go: only on the way
        for text in texts
        for call in iter_calls(parse_predicate(text, template=True).formula)
        if read_statement(call).meaning not in passed
        for term in call.terms
    )
    return tuple(sorted({term.text for term in terms if isinstance(term, Name)} - brought))


def _build_dag(nodes: Mapping[str, Node]) -> "nx.DiGraph[str]":
    dag: nx.DiGraph[str] = nx.DiGraph()
    dag.add_nodes_from(nodes)
    for node in nodes.values():
        for before in node.predecessors:
            outputs = tuple(dict.fromkeys(edge.output for edge in node.data if edge.node == before))
            dag.add_edge(before, node.name, data=outputs, on_failure=before not in node.after)
    return dag


def override_yaml(located: Located, overrides: Mapping[str, str]) -> Located:
    """The same data with single values replaced; `targets.arm` names a place by its keys."""
    if not overrides or not isinstance(located.data, dict):
        return located
    data, origins = copy.deepcopy(located.data), dict(located.origins)
    for dotted, text in overrides.items():
        *parents, key = dotted.split(".")
        place: Fields = data
        for parent in parents:
            place[parent] = {} if place.get(parent) is None else place[parent]
            if not isinstance(place := place[parent], dict):
                raise DefinitionError.of("INVALID_VALUE", dotted, f"{parent!r} is no mapping")
        if parents == ["targets"] and key not in place:  # a role that no node names binds nothing
            raise DefinitionError.unknown("role", dotted, key, map(str, place))
        shown = dotted
        if parents[:1] == ["parameters"]:
            shown, declared = parents[-1], as_dict(located.data.get("parameters"))
            if shown not in declared:
                known = [*declared, *(f"targets.{role}" for role in as_dict(located.data.get("targets")))]
                raise DefinitionError.unknown("parameter", f"--set {shown}", shown, known)
        given = parse_yaml(text, f"--set {shown}")
        place[key], origins[(*parents, key)] = given.data, (given, ())
    return replace(located, data=data, origins=origins)
