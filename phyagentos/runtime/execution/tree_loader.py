"""Builds a running py_trees tree from an authored one.

Upstream: `tree_check`, which has found it sound. Downstream: the tree runtime. py_trees keeps one blackboard per
process; each built tree uses a namespace of its own there and clears it when it is closed.
"""

import itertools
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from py_trees.behaviour import Behaviour
from py_trees.blackboard import Blackboard
from py_trees.common import ParallelPolicy
from py_trees.composites import Parallel, Selector, Sequence
from py_trees.decorators import Inverter, Retry

from phyagentos.errors import DefinitionError
from phyagentos.protocol.library import Library
from phyagentos.protocol.trees import Kind, Node, Reference, Tree, find_references, read_tree
from phyagentos.runtime.execution.context import SkillContext
from phyagentos.runtime.execution.decorators import Condition, SimulatedTimeout
from phyagentos.runtime.execution.leaf import Leaf
from phyagentos.runtime.execution.port_types import EXPORTED_TYPES, PORT_TYPES, convert_literal, export_value
from phyagentos.runtime.execution.registry import LeafRegistry
from phyagentos.runtime.execution.tree_check import check_tree

_SERIAL = itertools.count()  # tells the namespaces of one process apart; never part of a result


@dataclass(frozen=True, slots=True)
class BuiltNode:
    """One node of the running tree, with what the trace says of it."""

    behaviour: Behaviour
    path: str
    type: str


@dataclass(frozen=True, slots=True)
class BuiltTree:
    """A tree that can be ticked.

    Attributes:
        root: What to tick.
        nodes: All nodes, parents first.
        output_keys: Output -> blackboard key, of the outputs that a contract can carry.
        namespace: Prefix of everything it keeps on the blackboard.
    """

    root: Behaviour
    nodes: tuple[BuiltNode, ...]
    output_keys: Mapping[str, str]
    namespace: str

    def read_outputs(self) -> dict[str, Any]:
        """The outputs that were written, as plain data."""
        storage = Blackboard.storage
        return {name: export_value(storage[key]) for name, key in self.output_keys.items() if key in storage}

    def close(self) -> None:
        """Forget everything it kept on the blackboard."""
        for node in self.nodes:
            for client in node.behaviour.blackboards:
                client.unregister(clear=False)
        for key in [key for key in Blackboard.storage if key.startswith(self.namespace)]:
            del Blackboard.storage[key]
        for key in [key for key in Blackboard.metadata if key.startswith(self.namespace)]:
            del Blackboard.metadata[key]


def build_tree(
    name: str, parameters: Mapping[str, Any], context: SkillContext, library: Library, registry: LeafRegistry
) -> BuiltTree:
    """Build a tree for one session.

    Args:
        name: Of the tree.
        parameters: Values of its inputs.
        context: Services for its leaves.
        library: Where trees are found.
        registry: The leaves that exist.

    Raises:
        DefinitionError: With every problem of the tree and of the trees below it.
    """
    problems = check_tree(name, library, registry)
    if problems:
        raise DefinitionError(problems)
    session = re.sub(r"[^A-Za-z0-9_]", "_", context.session.id)
    builder = _Builder(context, library, registry, f"/{session}_{next(_SERIAL)}")
    tree = read_tree(library.get_tree(name))
    scope = builder.open_scope(tree, parameters, {}, "main")
    root = builder.build(tree.root, scope, tree.root.name)
    return BuiltTree(
        root=root,
        nodes=tuple(builder.nodes),
        output_keys={name: scope[name] for name, port in tree.header.outputs.items() if port.type in EXPORTED_TYPES},
        namespace=builder.namespace + "/",
    )


class _Scope(dict[str, str]):
    """Keys of one tree instance -> blackboard keys; a key not wired from outside is the instance's own."""

    def __init__(self, prefix: str) -> None:
        super().__init__()
        self._prefix = prefix

    def __missing__(self, key: str) -> str:
        self[key] = f"{self._prefix}/{key}"
        return self[key]


class _Builder:
    def __init__(self, context: SkillContext, library: Library, registry: LeafRegistry, namespace: str) -> None:
        self.namespace = namespace
        self.nodes: list[BuiltNode] = []
        self._context = context
        self._library = library
        self._registry = registry
        self._literals = itertools.count()

    def open_scope(self, tree: Tree, wiring: Mapping[str, Any], outer: Mapping[str, str], instance: str) -> _Scope:
        """The keys of one instance of a tree: inputs and outputs wired, literals and defaults written."""
        scope = _Scope(f"{self.namespace}/{instance}")
        for port, information in tree.header.inputs.items():
            value = wiring.get(port, information.default)
            if isinstance(value, Reference):
                scope[port] = outer[value.key]
            elif value is not None:
                scope[port] = self._write_literal(value, PORT_TYPES[information.type])
        for port in tree.header.outputs:
            value = wiring.get(port)
            if isinstance(value, Reference):
                scope[port] = outer[value.key]
        return scope

    def build(self, node: Node, scope: _Scope, path: str) -> Behaviour:
        """Build a node and everything below it."""
        if node.kind is Kind.SUBTREE:
            return self._build_subtree(node, scope, path)
        position = len(self.nodes)  # parents before children
        children = [self.build(child, scope, f"{path}/{child.name}") for child in node.children]
        behaviour = self._build_one(node, children, scope, path)
        self.nodes.insert(position, BuiltNode(behaviour, path, node.type))
        return behaviour

    def _build_subtree(self, node: Node, scope: _Scope, path: str) -> Behaviour:
        tree = read_tree(self._library.get_tree(node.type))
        inner = self.open_scope(tree, node.wiring, scope, f"scope{next(self._literals)}")
        return self.build(tree.root, inner, path)

    def _build_one(self, node: Node, children: list[Behaviour], scope: _Scope, path: str) -> Behaviour:
        context = self._context
        match node.kind:
            case Kind.SEQUENCE:
                return Sequence(node.name, memory=True, children=children)
            case Kind.FALLBACK:
                return Selector(node.name, memory=True, children=children)
            case Kind.PARALLEL:
                policy = (
                    ParallelPolicy.SuccessOnAll(synchronise=True)
                    if node.policy == "all"
                    else ParallelPolicy.SuccessOnOne()
                )
                return Parallel(node.name, policy=policy, children=children)
            case Kind.RETRY:
                return Retry(node.name, children[0], num_failures=int(node.amount))
            case Kind.TIMEOUT:
                return SimulatedTimeout(node.name, children[0], node.amount, context)
            case Kind.INVERT:
                return Inverter(node.name, children[0])
            case Kind.CONDITION:
                leaf: Leaf = Condition(node.name, context, path, node.text, self._read_keys(node.text, scope))
                leaf.setup_ports(subtree_namespace=self.namespace)
                return leaf
        return self._build_leaf(node, scope, path)

    def _build_leaf(self, node: Node, scope: _Scope, path: str) -> Leaf:
        leaf = self._registry.get(node.type)(node.name, self._context, path)
        ports = leaf.input_ports()
        remappings = {
            port: scope[value.key]
            if isinstance(value, Reference)
            else self._write_literal(value, ports[port].data_type)
            for port, value in node.wiring.items()
        }
        leaf.setup_ports(port_remappings=remappings, subtree_namespace=self.namespace)
        return leaf

    def _write_literal(self, value: Any, kind: type) -> str:
        key = f"{self.namespace}/literal/{next(self._literals)}"
        Blackboard.storage[key] = convert_literal(value, kind)
        return key

    def _read_keys(self, text: str, scope: _Scope) -> Callable[[], Mapping[str, object]]:
        keys = {name: scope[name] for name in find_references(text)}
        storage = Blackboard.storage
        return lambda: {name: storage[key] for name, key in keys.items() if key in storage}
