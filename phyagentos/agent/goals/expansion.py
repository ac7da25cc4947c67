"""Expands authored nodes into the nodes of the graph: fan-out of `foreach`, references, precedence and data edges.

A node that fans out over `cube` becomes `each-green_cube`, `each-yellow_cube`: safe in ids and file names, and never
equal to an authored name, which cannot hold a hyphen.
"""

import itertools
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from phyagentos.agent.goals.spec import REFERENCE, GoalSpec, NodeSpec, Promise
from phyagentos.errors import Problem
from phyagentos.protocol.documents.schema import Located
from phyagentos.protocol.predicates.syntax import format_value
from phyagentos.protocol.sessions.session import NODE_MAX

Path = tuple[str | int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class DataEdge:
    """`${node.outputs.output}` somewhere in a node."""

    node: str
    output: str
    path: Path


@dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """One node of the graph.

    Attributes:
        authored: Name under `sessions`; `name` has the values of its fan-out besides.
        spec: As authored, with the fan-out variables substituted.
        after: Direct predecessors by precedence or by data, in authored order; it waits for their success.
        on_failure: Edges on failure: of each one the nodes of which at least one must have failed.
    """

    name: str
    authored: str
    spec: NodeSpec
    after: tuple[str, ...]
    data: tuple[DataEdge, ...]
    on_failure: tuple[tuple[str, ...], ...] = ()

    @property
    def predecessors(self) -> tuple[str, ...]:
        """Every node that it waits for."""
        return tuple(dict.fromkeys((*self.after, *itertools.chain(*self.on_failure))))

    @property
    def is_open(self) -> bool:
        """Whether it stands for nodes that are known once it is ready: it fans out over what is seen then."""
        return any(isinstance(values, str) for values in self.spec.foreach.values())

    @property
    def is_conditional(self) -> bool:
        """Whether what is seen once it is ready decides on it."""
        return self.is_open or bool(self.spec.when)

    @property
    def path(self) -> Path:
        """Where it stands in the file."""
        return ("sessions", self.authored)


def expand_nodes(
    spec: GoalSpec, located: Located, problems: list[Problem], includes: Mapping[str, Sequence[str]]
) -> dict[str, Node]:
    """Every node of the graph by name, in authored order; adds to `problems`. `includes`: include -> its nodes."""
    expanded = {name: [*_iter_fan_out(name, node, located, problems)] for name, node in spec.sessions.items()}
    known = {authored: tuple(name for name, _ in members) for authored, members in expanded.items()}
    groups = {group: tuple(itertools.chain(*(known.get(each, ()) for each in m))) for group, m in includes.items()}
    known |= {name: (name,) for members in expanded.values() for name, _ in members} | groups
    nodes = {}
    for authored, members in expanded.items():
        for name, node in members:
            variables = (*spec.sessions[authored].foreach, *spec.parameters)
            data = tuple(_iter_data_edges(authored, node, variables, known, located, problems))
            for index, edge in enumerate(node.after):
                if edge.node not in known:
                    path = ("sessions", authored, "after", index)
                    others = [each for each in known if each not in (authored, name)]
                    problems.append(located.unknown("node", path, edge.node, others))
            waits = [(edge.on, known[edge.node]) for edge in node.after if edge.node in known]
            after = [*(each for on, names in waits if on == "success" for each in names), *(edge.node for edge in data)]
            nodes[name] = Node(
                name=name,
                authored=authored,
                spec=node,
                after=tuple(dict.fromkeys(after)),
                data=data,
                on_failure=tuple(names for on, names in waits if on == "failure"),
            )
    return nodes


def substitute_value(value: object, parameters: Mapping[str, object]) -> Any:
    """Replace `${path}` in every string of a value; a string that is one reference becomes the value itself."""
    if isinstance(value, str):
        whole = REFERENCE.fullmatch(value.strip())
        if whole and whole[1] in parameters:
            return parameters[whole[1]]
        return REFERENCE.sub(lambda m: format_value(parameters[m[1]]) if m[1] in parameters else m[0], value)
    if isinstance(value, Mapping):
        return {key: substitute_value(item, parameters) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [substitute_value(item, parameters) for item in value]
    return value


def iter_strings(value: object, path: Path = ()) -> Iterator[tuple[Path, str]]:
    """Every string inside a value, with its path."""
    if isinstance(value, str):
        yield path, value
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from iter_strings(item, (*path, key))
    elif isinstance(value, list | tuple):
        for index, item in enumerate(value):
            yield from iter_strings(item, (*path, index))


def _iter_fan_out(
    name: str, node: NodeSpec, located: Located, problems: list[Problem]
) -> Iterator[tuple[str, NodeSpec]]:
    if not node.foreach or any(isinstance(values, str) for values in node.foreach.values()):
        if len(name) > NODE_MAX:
            expected = f"names that make one of at most {NODE_MAX} letters"
            problems.append(located.problem("INVALID_VALUE", ("sessions", name), repr(name), expected))
        yield name, node
        return
    seen: set[str] = set()
    path = ("sessions", name, "foreach")
    for values in itertools.product(*node.foreach.values()):
        label = "-".join(re.sub(r"[^A-Za-z0-9_]", "_", format_value(value)) for value in values)
        if label in seen:
            problems.append(located.problem("DUPLICATE_NAME", path, repr(label), "values that differ"))
            continue
        seen.add(label)
        if len(full := f"{name}-{label}") > NODE_MAX:
            expected = f"values that make a name of at most {NODE_MAX} letters"
            problems.append(located.problem("INVALID_VALUE", path, repr(full), expected))
        data = node.model_dump(by_alias=True, exclude={"foreach"}, exclude_unset=True)
        bound = substitute_value(data, dict(zip(node.foreach, values, strict=True)))
        yield full, NodeSpec.model_validate(bound)
    if not seen:
        problems.append(located.problem("MISSING_VALUE", path, "no value", "at least one"))


def _iter_data_edges(
    authored: str,
    node: NodeSpec,
    variables: Iterable[str],
    known: Mapping[str, tuple[str, ...]],
    located: Located,
    problems: list[Problem],
) -> Iterator[DataEdge]:
    fields = {
        "with": node.arguments,
        "requires": node.requires,
        "hold": node.hold,
        "accept": node.accept,
        "skill": {"guarantees": node.skill.guarantees} if isinstance(node.skill, Promise) else "",
        "objective": node.objective,
    }
    for inner, text in iter_strings(fields):
        path = ("sessions", authored, *inner)
        for match in REFERENCE.finditer(text):
            reference = match[1]
            if reference in node.arguments or reference in node.foreach:
                continue
            source, _, output = reference.partition(".outputs.")
            members = known.get(source, ())
            if not output:
                possible = [*variables, *node.arguments, *(f"{name}.outputs.<name>" for name in known)]
                problems.append(located.unknown("reference", path, reference, possible, match[0]))
            elif not members:
                problems.append(located.unknown("node", path, source, known, f"{source!r} in {match[0]}"))
            elif len(members) > 1:
                expected = " or ".join(f"${{{member}.outputs.{output}}}" for member in members)
                problems.append(located.problem("INVALID_VALUE", path, match[0], expected))
            else:
                yield DataEdge(node=members[0], output=output, path=path)
