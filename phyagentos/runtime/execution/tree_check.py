"""Checks authored trees against the registered leaves, and reports every problem at once."""

from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace as replace_port
from typing import Any

from msgspec.structs import replace
from py_trees.ports import PortInformation

from phyagentos.errors import DefinitionError, Problem, format_hint, format_names, raise_any
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.trees import (
    Node,
    NodeKind,
    Reference,
    Tree,
    find_oversize,
    find_references,
    iter_nodes,
    list_subtrees,
    load_tree,
    read_tree,
    split_path,
)
from phyagentos.protocol.documents.schema import Address
from phyagentos.protocol.documents.yaml_scalars import advise_form, format_scalar
from phyagentos.protocol.predicates.predicate import parse_predicate
from phyagentos.protocol.sessions.trace import Role
from phyagentos.runtime.execution.call_check import iter_form_problems
from phyagentos.runtime.execution.leaf import Leaf
from phyagentos.runtime.execution.leaf_registry import LeafRegistry
from phyagentos.runtime.execution.port_types import ELEMENTS, PORT_TYPES
from phyagentos.runtime.execution.ports import Port, expand_ports, find_misfit
from phyagentos.runtime.execution.subtrees import iter_trees

REACTIVE = (NodeKind.REACTIVE_SEQUENCE, NodeKind.REACTIVE_FALLBACK)
_CONTROL_WORDS = tuple(kind.value for kind in NodeKind if kind is not NodeKind.LEAF)


def check_tree(name: str, library: Library, registry: LeafRegistry) -> list[Problem]:
    """Every problem of a tree and its subtrees; a sound tree is not checked again before a file changes."""
    return _check(name, library, registry)[1]


def read_sound_trees(name: str, library: Library, registry: LeafRegistry) -> Mapping[str, Tree]:
    """A tree and its subtrees, by name, just as they were checked; raises DefinitionError with every problem."""
    trees, problems = _check(name, library, registry)
    raise_any(problems)
    return trees


def _check(name: str, library: Library, registry: LeafRegistry) -> tuple[Mapping[str, Tree], list[Problem]]:
    loaded = list(iter_trees(name, library))
    trees = {name: tree for name, tree, _ in loaded if tree is not None}
    found = tuple(trees.values())
    if registry.is_sound(library, name, found):
        return trees, []
    problems: list[Problem] = []
    for _, tree, flaws in loaded:
        problems += flaws
        if tree is not None:
            problems += check_loaded_tree(tree, library, registry)
    if not problems:
        registry.note_sound(library, name, found)
    return trees, problems


def check_loaded_tree(tree: Tree, library: Library, registry: LeafRegistry) -> Iterator[Problem]:
    """Every problem of one tree itself, without its subtrees."""
    if (oversize := find_oversize(tree, library)) is not None:
        yield from oversize[1:] if oversize[0] == tree.header.tree else ()  # else it is a problem of that one
        return
    written = {name: PORT_TYPES[port.type] for name, port in tree.header.inputs.items()}
    nodes = list(iter_nodes(tree.root))
    known: dict[str, Ports | None] = {}
    declared = [(node, _find_ports(node, library, registry, known)) for node in nodes]
    for node, ports in declared:
        for port, value in node.wiring.items():
            if not isinstance(value, Reference):
                continue
            if ports is not None and port in ports[1]:
                written.setdefault(value.key, ports[1][port].data_type)
            elif _is_unread(node, registry):
                written.setdefault(value.key, object)  # perhaps
        if node.kind is NodeKind.FOR_EACH:
            yield from _iter_list_problems(tree, node, written)
    for node, ports in declared:
        if node.kind is NodeKind.CONDITION:
            yield from _iter_condition_problems(tree, node, written)
        elif node.kind in REACTIVE:
            yield from _iter_reactive_problems(tree, node, library, registry)
        elif node.kind in (NodeKind.LEAF, NodeKind.SUBTREE):
            if ports is not None:
                yield from _iter_wiring_problems(tree, node, ports, written)
                yield from iter_form_problems(tree, node)
            elif not _is_unread(node, registry):
                yield _problem_unknown(tree, node, library, registry)
            if node.kind is NodeKind.SUBTREE and (way := _find_way(node.type, tree.header.tree, library, set())):
                cycle = " -> ".join((tree.header.tree, *way))
                expected, hint = "another tree, without a way back", "For what is done again use 'repeat' or 'retry'."
                yield tree.located.problem("CYCLE", node.address, cycle, expected, hint)
    yield from _iter_default_problems(tree, library, registry)
    for name in tree.header.outputs:
        if name not in written:
            yield tree.located.unknown("written key", ("outputs", name), name, written)


def _iter_default_problems(tree: Tree, library: Library, registry: LeafRegistry) -> Iterator[Problem]:
    own, bounds = tree.located.data.get("inputs", {}), find_ranges(tree, library, registry)
    for name, port in tree.header.inputs.items():
        if name in own and port.default is not None:
            declared = _declare(bounds.get(name), PORT_TYPES[port.type])
            yield from _iter_literal_problems(tree, ("inputs", name, "default"), port.default, declared)


def _declare(bounds: Port | None, kind: type, *, required: bool = False) -> Port:
    """The port of a tree: its own type, and the range of the port that reads it."""
    return replace_port(bounds or Port(object), data_type=kind, required=required, default_value=None)


def _is_unread(node: Node, registry: LeafRegistry) -> bool:
    """Whether it is a leaf whose Python was not executed, so that its ports are unknown."""
    return node.kind is NodeKind.LEAF and registry.is_announced(node.type)


def _find_way(start: str, goal: str, library: Library, seen: set[str]) -> tuple[str, ...]:
    """Names of trees from one to another, along subtrees; empty where none leads there."""
    if start == goal:
        return (goal,)
    if start in seen or not library.has_tree(start):
        return ()
    seen.add(start)
    tree, _ = load_tree(library.get_tree(start))
    below = dict.fromkeys(list_subtrees(tree) if tree is not None else ())
    ways = (_find_way(each, goal, library, seen) for each in below)
    return next(((start, *way) for way in ways if way), ())


def _iter_list_problems(tree: Tree, node: Node, written: dict[str, type]) -> Iterator[Problem]:
    """Problems of a `for_each`; the key of its element counts as written."""
    values, each = node.wiring["in"], node.wiring["each"].key
    place = (*node.address, "in")
    if isinstance(values, Reference):
        if values.key not in written:
            yield _problem_unwritten(tree, place, values.key, written)
            return
        kind = written[values.key]
        found = f"'{values}' of type {_name_of(kind)}"
    else:
        kind, found = find_list_type(values), repr(values)
    if kind is object:  # by a leaf that was not executed
        written.setdefault(each, object)
    elif kind not in ELEMENTS:
        yield tree.located.problem("INVALID_VALUE", place, found, "a list: names of entities, or points")
    elif written.setdefault(each, ELEMENTS[kind]) is not ELEMENTS[kind]:
        found = f"'${{{each}}}' of type {_name_of(written[each])}"
        yield tree.located.problem("INVALID_VALUE", (*node.address, "each"), found, f"type {_name_of(ELEMENTS[kind])}")


def _iter_reactive_problems(tree: Tree, node: Node, library: Library, registry: LeafRegistry) -> Iterator[Problem]:
    """Each tick begins with the first child again: of two that take time, the first would never let the second end."""
    slow = [child for child in node.children if _takes_time(child, library, registry)]
    for child in slow[1:]:
        yield tree.located.problem(
            "BROKEN_TREE",
            child.address,
            found=f"{child.name!r} and {slow[0].name!r}, which both take time, in one {node.kind}",
            expected="one child that takes time, conditions beside it",
            hint=f"Put them into a '{node.kind.removeprefix('reactive_')}' of their own.",
        )


def _takes_time(node: Node, library: Library, registry: LeafRegistry) -> bool:
    """Whether a leaf below is ticked more than once; what is unknown counts as quick, its problem is another."""
    leaves = (registry.find(each.type) for each in _list_leaves(node, library))
    return any(leaf is not None and leaf.on_running is not Leaf.on_running for leaf in leaves)


def needs_grasp(node: Node, library: Library, registry: LeafRegistry) -> bool:
    """Whether a node succeeds only where a grasp is planned: by a leaf of that role, below sequences and subtrees."""
    leaves = (registry.find(each.type) for each in _list_leaves(node, library, (NodeKind.SEQUENCE,)))
    return any(leaf is not None and leaf.ROLE is Role.PLAN_GRASP for leaf in leaves)


def _list_leaves(node: Node, library: Library, below: Collection[NodeKind] = tuple(NodeKind)) -> Iterator[Node]:
    """The leaves of a node and its subtrees, each tree once, below nodes of these kinds; of unreadable trees none."""
    waiting, seen = [node], set[str]()
    while waiting:
        node = waiting.pop()
        if node.kind is NodeKind.LEAF:
            yield node
        elif node.kind is NodeKind.SUBTREE and node.type not in seen:
            seen.add(node.type)
            with suppress(DefinitionError):
                waiting.append(read_tree(library.get_tree(node.type)).root)
        elif node.kind in below:
            waiting += node.children


def find_ranges(tree: Tree, library: Library, registry: LeafRegistry) -> Mapping[str, Port]:
    """Key of a tree -> the port that reads it, for each number; none of a tree that is too large."""
    is_sound = find_oversize(tree, library) is None
    return _find_bounds(tree, library, registry, {tree.header.tree: None}) if is_sound else {}


Ports = tuple[Mapping[str, PortInformation], Mapping[str, PortInformation]]  # inputs, outputs


def _find_ports(node: Node, library: Library, registry: LeafRegistry, known: dict[str, Ports | None]) -> Ports | None:
    """Declared ports of a leaf or, kept in `known`, a subtree; None when there is no such leaf or readable tree."""
    if node.kind is NodeKind.LEAF:
        leaf = registry.find(node.type)
        parts = () if leaf is None else (leaf.INPUT_PORTS, leaf.OUTPUT_PORTS)
        return None if not parts else (expand_ports(parts[0], node.wiring), expand_ports(parts[1], node.wiring))
    if node.kind is NodeKind.SUBTREE and node.type not in known:
        known[node.type] = None  # for one that leads back to it
        try:
            tree = read_tree(library.get_tree(node.type))
        except DefinitionError:
            return None
        header, bounds = tree.header, _find_bounds(tree, library, registry, known)
        inputs = {
            name: _declare(bounds.get(name), PORT_TYPES[port.type], required=not port.optional and port.default is None)
            for name, port in header.inputs.items()
        }
        outputs = {
            name: PortInformation(data_type=PORT_TYPES[port.type], required=False)
            for name, port in header.outputs.items()
        }
        known[node.type] = inputs, outputs
    return known.get(node.type) if node.kind is NodeKind.SUBTREE else None


def _find_bounds(
    tree: Tree, library: Library, registry: LeafRegistry, known: dict[str, Ports | None]
) -> dict[str, Port]:
    """Key of a tree -> the first port with a type of number that reads it, in the tree or in subtrees."""
    found: dict[str, Port] = {}
    for node in iter_nodes(tree.root):
        inputs = (_find_ports(node, library, registry, known) or ({}, {}))[0]
        for name, value in node.wiring.items():
            port = inputs.get(name)
            if isinstance(value, Reference) and isinstance(port, Port) and port.data_type is float:
                found.setdefault(value.key, port)
    return found


def _problem_unknown(tree: Tree, node: Node, library: Library, registry: LeafRegistry) -> Problem:
    if node.kind is NodeKind.SUBTREE:
        known = library.names_of_trees()
        place = (*node.address, "tree")
        if node.type not in known:
            return tree.located.unknown("tree", place, node.type, known)
        unread, hint = f"{node.type!r}, which cannot be read", f"Mend {node.type!r} first."
        return tree.located.problem("BROKEN_TREE", place, unread, "a sound tree", hint)
    found = tree.located.unknown("leaf", node.address, node.type, registry.names())
    return replace(found, hint=format_hint(node.type, [*registry.names(), *_CONTROL_WORDS]))


def _iter_wiring_problems(tree: Tree, node: Node, ports: Ports, written: dict[str, type]) -> Iterator[Problem]:
    inputs, outputs = ports
    base = (*node.address, "with") if node.kind is NodeKind.SUBTREE else node.address
    for port, value in node.wiring.items():
        place = (*base, *split_path(port))
        known = [*inputs, *outputs]
        if port not in known:
            unknown = tree.located.unknown("port", place, port, known)
            declare = f"Declare it as an input or output of {node.type!r}."
            is_bare = node.kind is NodeKind.SUBTREE and not known
            yield replace(unknown, hint=declare) if is_bare else unknown
        elif isinstance(value, Reference):
            yield from _iter_reference_problems(tree, place, value, {**inputs, **outputs}[port], written)
        elif port in outputs:
            yield tree.located.problem(
                "INVALID_VALUE", place, repr(value), f"a key such as '${{{place[-1]}}}' to write to"
            )
        else:
            yield from _iter_literal_problems(tree, place, value, inputs[port])
    for port, information in inputs.items():
        if information.required and not information.has_default and port not in node.wiring:
            yield tree.located.problem(
                "MISSING_VALUE",
                node.address,
                found=f"{node.type} without {port!r}",
                expected=f"a value for {port!r}",
                hint=f"Add {port}: VALUE{' below `with`' if node.kind is NodeKind.SUBTREE else ''}.",
            )


def _iter_reference_problems(
    tree: Tree, place: Address, value: Reference, port: PortInformation, written: dict[str, type]
) -> Iterator[Problem]:
    if value.key not in written:
        yield _problem_unwritten(tree, place, value.key, written)
    elif object not in (port.data_type, written[value.key]) and port.data_type is not written[value.key]:
        found = f"'{value}' of type {_name_of(written[value.key])}"
        yield tree.located.problem("INVALID_VALUE", place, found, f"type {_name_of(port.data_type)}")


def _problem_unwritten(tree: Tree, place: Address, key: str, written: Mapping[str, type]) -> Problem:
    """A key that is read, and that nothing writes."""
    found, possible = (
        f"'{Reference(key)}', which nothing writes",
        format_names(str(Reference(each)) for each in written),
    )
    return tree.located.problem("BROKEN_TREE", place, found, possible, format_hint(key, written))


def _iter_literal_problems(tree: Tree, place: Address, value: Any, port: PortInformation) -> Iterator[Problem]:
    try:
        convert_literal(value, port.data_type)
    except TypeError:
        is_key = isinstance(value, str) and value.isidentifier()
        wanted = {float: "number", int: "integer", bool: "boolean", str: "string"}.get(port.data_type, "")
        hint = advise_form(value, wanted) or (f"A key is written '${{{value}}}'." if is_key else "")
        expected = f"type {_name_of(port.data_type)}"
        yield tree.located.problem("INVALID_VALUE", place, format_scalar(value), expected, hint or port.description)
        return
    if expected := find_misfit(value, port):
        yield tree.located.problem("INVALID_VALUE", place, format_scalar(value), expected, port.description)
    elif isinstance(value, str) and value in tree.header.inputs and place[-1] == value:
        wanted = f"a name of the scene, or the key '${{{value}}}'"
        yield tree.located.problem("INVALID_VALUE", place, format_scalar(value), wanted, "A key stands in ${ }.")


def _iter_condition_problems(tree: Tree, node: Node, written: dict[str, type]) -> Iterator[Problem]:
    try:
        predicate = parse_predicate(node.text, address=tree.located.address_of(node.address), template=True)
        for each in predicate.iter_references():
            if each.name in tree.header.inputs:
                found, wanted = f"{each.name!r} in {node.text!r}", f"a name of the scene, or the key '${{{each.name}}}'"
                yield tree.located.problem("INVALID_VALUE", node.address, found, wanted, "A key stands in ${ }.")
    except DefinitionError as error:
        yield from error.problems
    for key in find_references(node.text):
        if key not in written:
            yield _problem_unwritten(tree, node.address, key, written)


def convert_literal(value: Any, kind: type) -> Any:
    """A value from YAML as a port takes it: whole numbers pass as numbers, lists as tuples.

    Raises:
        TypeError: When it is of another type.
    """
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if kind is tuple and isinstance(value, list):
        return tuple(value)
    if kind in ELEMENTS and isinstance(value, list | tuple):
        return kind(convert_literal(each, ELEMENTS[kind]) for each in value)
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise TypeError(f"{value!r} is not of type {kind.__name__}")
    return value


def find_list_type(values: Any) -> type:
    """The type of a literal list; that of the value where it is none, or a list of something else."""
    for kind in ELEMENTS if isinstance(values, list | tuple) else ():
        with suppress(TypeError):
            convert_literal(values, kind)
            return kind
    return type(values)


_TYPE_NAMES = {kind: name for name, kind in reversed(PORT_TYPES.items())} | {str: "string"}


def _name_of(kind: Any) -> str:
    """A type as trees write it."""
    return _TYPE_NAMES.get(kind) or str(getattr(kind, "__name__", kind))
