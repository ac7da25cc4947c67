"""Whether the calls of a tree fit the procedures that a target describes: names, types of messages, fields and values.

Upstream: `Description.procedures`, of the live target or as its kit has written them down. Downstream: preflight, lint.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from phyagentos.errors import DefinitionError, Problem, format_names
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.trees import (
    Node,
    NodeKind,
    Reference,
    Tree,
    iter_nodes,
    split_path,
)
from phyagentos.protocol.documents.schema import read_text
from phyagentos.protocol.documents.yaml_scalars import format_scalar
from phyagentos.protocol.world.environment import Pose
from phyagentos.runtime.execution.port_types import PORT_TYPES
from phyagentos.runtime.execution.subtrees import iter_trees
from phyagentos.runtime.targets.wire import Procedure

CALL = "call"
KINDS = ("action", "service", "topic", "procedure")
_FITTING: Mapping[type, set[str]] = {  # type of a value, or of a port of the tree -> of a field
    bool: {"boolean"},
    int: {"integer", "number"},
    float: {"number"},
    str: {"string", "pose", "point"},
    Pose: {"pose", "point"},
    tuple: {"point", "number[]"},
}
_EVERY = set[str]().union(*_FITTING.values())


def find_call(given: Mapping[str, Any]) -> tuple[str, str]:
    """Kind and name of what a node calls; empty unless it names exactly one."""
    named = [(kind, str(given[kind])) for kind in KINDS if given.get(kind) is not None]
    return named[0] if len(named) == 1 else ("", "")


def find_type(types: Mapping[str, str], path: str) -> str:
    """Type of a field by its path, in which elements have numbers; empty where there is none."""
    return types.get(re.sub(r"\.\d+(?=\.|$)", "[]", path), "")


def iter_form_problems(tree: Tree, node: Node) -> Iterator[Problem]:
    """A call names one object to call."""
    if node.type == CALL and not any(find_call(node.wiring)):
        found = ", ".join(kind for kind in KINDS if kind in node.wiring) or "none"
        yield tree.located.problem("MISSING_VALUE", node.address, found, f"one of {', '.join(KINDS)}")


def iter_call_problems(name: str, library: Library, procedures: Sequence[Procedure], target: str) -> Iterator[Problem]:
    """Where calls of a tree and its subtrees do not fit; trees that cannot be read have problems of their own."""
    for _, tree, flaws in iter_trees(name, library):
        if tree is not None and not flaws:
            yield from iter_own_problems(tree, procedures, target)


def iter_own_problems(tree: Tree, procedures: Sequence[Procedure], target: str) -> Iterator[Problem]:
    """As `iter_call_problems`, of one tree itself."""
    for node in iter_nodes(tree.root):
        if node.kind is NodeKind.LEAF and node.type == CALL:
            yield from _iter_node_problems(tree, node, procedures, target)


def read_procedures(path: Path) -> tuple[Procedure, ...]:
    """What a kit has written down of a robot's procedures, as JSON; raises DefinitionError."""
    try:
        return msgspec.json.decode(read_text(path), type=tuple[Procedure, ...])
    except msgspec.DecodeError as error:
        expected = "what `python -m ros2_body.interfaces` writes"
        raise DefinitionError.of("INVALID_VALUE", str(path), str(error), expected) from error


def _iter_node_problems(tree: Tree, node: Node, procedures: Sequence[Procedure], target: str) -> Iterator[Problem]:
    kind, name = find_call(node.wiring)
    if not kind or isinstance(node.wiring[kind], Reference):  # known when it runs
        return
    procedure = next((each for each in procedures if each.name == name), None)
    if procedure is None:
        place, known = (*node.address, kind), [each.name for each in procedures]
        yield tree.located.unknown("procedure", place, name, known, f"{name!r}, which {target} does not offer")
        return
    if kind != KINDS[-1] and procedure.kind != kind:
        place = (*node.address, kind)
        yield tree.located.problem("INVALID_VALUE", place, f"{kind} {name!r}", f"it as {procedure.kind}")
    wanted = node.wiring.get("type", procedure.type)
    if not isinstance(wanted, Reference) and wanted != procedure.type:
        found, place = format_scalar(wanted), (*node.address, "type")
        yield tree.located.problem("TARGET_MISMATCH", place, found, procedure.type or "no type")
    for path, value in node.wiring.items():
        part, _, below = path.partition(".")
        types: Mapping[str, str] = getattr(procedure, part) if part in ("goal", "feedback", "result") else {}
        place = (*node.address, *split_path(path))
        if below and not (expected := find_type(types, below)):
            yield tree.located.unknown(f"field of {part}", place, below, types)
        elif below and part == "goal" and expected not in (fitting := _find_fitting(tree, value)):
            yield tree.located.problem("INVALID_VALUE", place, _show(value, fitting), f"type {expected}")


def _find_fitting(tree: Tree, value: object) -> set[str]:
    """Types of fields that a value can fill; every one where that is known only when it runs."""
    if isinstance(value, Reference):
        port = tree.header.inputs.get(value.key)
        return _EVERY if port is None else _FITTING.get(PORT_TYPES[port.type], set())
    if isinstance(value, tuple):
        kinds = [_FITTING.get(type(each), set()) for each in value] or [_EVERY]
        lists = {f"{kind}[]" for kind in set.intersection(*kinds)}
        return lists | ({"point"} if len(value) == len("xyz") and "number[]" in lists else set())
    return _FITTING.get(type(value), set())


def _show(value: object, fitting: set[str]) -> str:
    return f"'{value}', which fits {format_names(fitting)}" if isinstance(value, Reference) else format_scalar(value)
