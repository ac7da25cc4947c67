"""Builds a running py_trees tree from a checked one, with the format's own timeout and condition.

py_trees keeps one blackboard per process; a built tree keeps the values of its ports itself.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from py_trees.behaviour import Behaviour
from py_trees.common import ParallelPolicy, Status
from py_trees.composites import Parallel, Selector, Sequence
from py_trees.decorators import Decorator, Inverter, Repeat, Retry

from phyagentos.errors import DefectError, blaming
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.trees import Node, NodeKind, Reference, Tree, find_references
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.predicates.predicate import parse_predicate, substitute
from phyagentos.protocol.sessions.trace import Role
from phyagentos.protocol.world.truth import Truth
from phyagentos.runtime.execution.context import SkillContext
from phyagentos.runtime.execution.leaf import TICK_S, FailureCode, Leaf
from phyagentos.runtime.execution.leaf_registry import LeafRegistry
from phyagentos.runtime.execution.port_types import EXPORTED_TYPES, PORT_TYPES
from phyagentos.runtime.execution.ports import expand_ports
from phyagentos.runtime.execution.tree_check import REACTIVE, convert_literal, find_list_type, read_sound_trees
from phyagentos.runtime.perception.world_model import BELIEF


class _Timed(Decorator):
    """A decorator that fails by itself, with a coded reason, by so many seconds of simulated time."""

    def __init__(self, name: str, child: Behaviour, seconds: float, context: SkillContext) -> None:
        super().__init__(name=name, child=child)
        self._seconds, self._context = seconds, context
        self.code = self.message = ""


class SimulatedTimeout(_Timed):
    """Fails when the child runs longer than so many seconds of simulated time; planning costs none."""

    _began_s = 0.0

    def initialise(self) -> None:
        """Store the start time."""
        self._began_s = self._context.time_s
        self.code, self.message = "", ""

    def update(self) -> Status:
        """The child's status, or FAILURE when time is up."""
        elapsed_s = self._context.time_s - self._began_s
        if self.decorated.status is Status.RUNNING and elapsed_s >= self._seconds:
            self.code = FailureCode.TIMED_OUT
            self.message = f"{self.decorated.name} still ran after {elapsed_s:.2f} s (limit {self._seconds} s)"
            return Status.FAILURE
        return self.decorated.status


class Cooldown(_Timed):
    """Ticks the child; for so many seconds of simulated time after it ended, FAILURE without it."""

    _ended_s: float | None = None

    def tick(self) -> Iterator[Behaviour]:
        """One tick of the child, or none."""
        rested_s = None if self._ended_s is None else self._context.time_s - self._ended_s
        if rested_s is not None and rested_s < self._seconds - 0.5 * self._context.profile.control_period_s:
            self.code = FailureCode.UNMET
            self.message = f"{self.decorated.name} ended {rested_s:.2f} s ago, of {self._seconds} s"
            self.status = Status.FAILURE
            yield self
            return
        self.code, self.message = "", ""
        yield from super().tick()

    def update(self) -> Status:
        """The child's status; its end is remembered."""
        self._ended_s = None if self.decorated.status is Status.RUNNING else self._context.time_s
        return self.decorated.status


class ForEach(Decorator):
    """Runs the child once for each element of the list under a key; succeeds at once when it is empty."""

    def __init__(self, name: str, child: Behaviour, values: Fields, source: str, target: str) -> None:
        super().__init__(name=name, child=child)
        self._values, self._source, self._target = values, source, target
        self._left: list[Any] = []

    def tick(self) -> Iterator[Behaviour]:
        """One tick of the child, unless the list is empty."""
        if self.status is not Status.RUNNING and not self._values[self._source]:
            self.status = Status.SUCCESS
            yield self
            return
        yield from super().tick()

    def initialise(self) -> None:
        """Begin with the first element."""
        self._left = list(self._values[self._source])
        self._values[self._target] = self._left.pop(0)

    def update(self) -> Status:
        """The child's status; after its success the next element, with the next tick."""
        if self.decorated.status is not Status.SUCCESS or not self._left:
            return self.decorated.status
        self._values[self._target] = self._left.pop(0)
        return Status.RUNNING


class Condition(Leaf):
    """Evaluates a predicate on the present world; unknown is never success.

    `text` is the predicate, with `${key}` for keys of the tree, whose values `read_keys` gives.
    """

    ROLE = Role.DECIDE

    def __init__(
        self, name: str, context: SkillContext, path: str, text: str, read_keys: Callable[[], Mapping[str, object]]
    ) -> None:
        super().__init__(name, context, path)
        self._text = text
        self._read_keys = read_keys

    def on_start(self) -> Status:
        """Substitute, parse, evaluate."""
        session = self.context.session
        text = substitute(self._text, self._read_keys())
        view = session.make_view(self.context.world.observe(BELIEF), self.context.initial)
        evaluation = parse_predicate(text).evaluate(view)
        if evaluation.truth is Truth.TRUE:
            return self.succeed(text)
        if evaluation.defect:
            raise DefectError("BROKEN_PYTHON", evaluation.because, evaluation.defect)
        return self.fail(FailureCode.UNMET, f"{text} is {evaluation.truth}: {evaluation.because}")


@dataclass(frozen=True, slots=True)
class BuiltNode:
    """One node of the running tree, with its names in the trace.

    `recurs` when a reactive composite above ticks it anew each time: only changes of its status are traced.
    """

    behaviour: Behaviour
    path: str
    type: str
    recurs: bool = False


@dataclass(frozen=True, slots=True)
class BuiltTree:
    """A tree that can be ticked; nodes are parents first.

    `output_keys` has the key of each output that a contract can carry, `values` the inputs and what leaves wrote.
    """

    root: Behaviour
    nodes: tuple[BuiltNode, ...]
    output_keys: Mapping[str, str]
    values: Fields


def build_tree(
    name: str, parameters: Mapping[str, Any], context: SkillContext, library: Library, registry: LeafRegistry
) -> BuiltTree:
    """Build a tree for one session; `parameters` are the values of its inputs.

    Raises:
        DefinitionError: With every problem of the tree and its subtrees.
    """
    trees = read_sound_trees(name, library, registry)
    builder = _Builder(context, trees, registry)
    tree = trees[name]
    scope = builder.open_scope(tree, parameters, {}, "main")
    root = builder.build(tree.root, scope, tree.root.name)
    return BuiltTree(
        root=root,
        nodes=tuple(builder.nodes),
        output_keys={name: scope[name] for name, port in tree.header.outputs.items() if port.type in EXPORTED_TYPES},
        values=builder.values,
    )


class _Scope(dict[str, str]):
    """Keys of one tree instance -> keys of the built tree; an unwired key is the instance's own."""

    def __init__(self, prefix: str) -> None:
        super().__init__()
        self._prefix = prefix

    def __missing__(self, key: str) -> str:
        self[key] = f"{self._prefix}/{key}"
        return self[key]


class _Builder:
    def __init__(self, context: SkillContext, trees: Mapping[str, Tree], registry: LeafRegistry) -> None:
        self.nodes: list[BuiltNode] = []
        self.values: Fields = {}
        self._context = context
        self._trees = trees
        self._registry = registry
        self._literals = itertools.count()

    def open_scope(self, tree: Tree, wiring: Mapping[str, Any], outer: Mapping[str, str], instance: str) -> _Scope:
        """The keys of one instance of a tree: inputs and outputs wired, literals and defaults written."""
        scope = _Scope(instance)
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

    def build(self, node: Node, scope: _Scope, path: str, recurs: bool = False) -> Behaviour:
        """Build a node and everything below it."""
        if node.kind is NodeKind.SUBTREE:
            tree = self._trees[node.type]
            return self.build(
                tree.root,
                scope=self.open_scope(tree, node.wiring, scope, f"scope{next(self._literals)}"),
                path=path,
                recurs=recurs,
            )
        position = len(self.nodes)  # parents before children
        below = recurs or node.kind in REACTIVE
        behaviour = self._build_one(
            node,
            children=[self.build(child, scope, f"{path}/{child.name}", below) for child in node.children],
            scope=scope,
            path=path,
        )
        self.nodes.insert(position, BuiltNode(behaviour, path, node.type, recurs))
        return behaviour

    def _build_one(self, node: Node, children: list[Behaviour], scope: _Scope, path: str) -> Behaviour:
        context = self._context
        match node.kind:
            case NodeKind.SEQUENCE | NodeKind.REACTIVE_SEQUENCE:
                return Sequence(node.name, memory=node.kind not in REACTIVE, children=children)
            case NodeKind.FALLBACK | NodeKind.REACTIVE_FALLBACK:
                return Selector(node.name, memory=node.kind not in REACTIVE, children=children)
            case NodeKind.PARALLEL:
                policy = (
                    ParallelPolicy.SuccessOnAll(synchronise=True)
                    if node.policy == "all"
                    else ParallelPolicy.SuccessOnOne()
                )
                return Parallel(node.name, policy=policy, children=children)
            case NodeKind.RETRY:
                return Retry(node.name, children[0], num_failures=int(node.amount))
            case NodeKind.REPEAT:
                return Repeat(node.name, children[0], num_success=int(node.amount))
            case NodeKind.FOR_EACH:
                values, each = node.wiring["in"], scope[node.wiring["each"].key]
                is_key = isinstance(values, Reference)
                return ForEach(
                    node.name,
                    children[0],
                    self.values,
                    source=scope[values.key] if is_key else self._write_literal(values, find_list_type(values)),
                    target=each,
                )
            case NodeKind.TIMEOUT:
                return SimulatedTimeout(node.name, children[0], node.amount, context)
            case NodeKind.COOLDOWN:
                return Cooldown(node.name, children[0], node.amount, context)
            case NodeKind.INVERT:
                return Inverter(node.name, children[0])
            case NodeKind.CONDITION:
                return Condition(node.name, context, path, node.text, self._read_keys(node.text, scope))
        return self._build_leaf(node, scope, path)

    def _build_leaf(self, node: Node, scope: _Scope, path: str) -> Leaf:
        kind = self._registry.get(node.type)
        with blaming(f"{kind.__name__}.__init__", kind, limit_s=TICK_S):
            leaf = kind(node.name, self._context, path)
        kinds = expand_ports(leaf.INPUT_PORTS, node.wiring)
        keys = {
            port: scope[value.key]
            if isinstance(value, Reference)
            else self._write_literal(value, kinds[port].data_type)
            for port, value in node.wiring.items()
        }
        leaf.wire(self.values, keys)
        return leaf

    def _write_literal(self, value: Any, kind: type) -> str:
        key = f"literal/{next(self._literals)}"
        self.values[key] = convert_literal(value, kind)
        return key

    def _read_keys(self, text: str, scope: _Scope) -> Callable[[], Mapping[str, object]]:
        keys = {name: scope[name] for name in find_references(text)}
        values = self.values
        return lambda: {name: values[key] for name, key in keys.items() if key in values}
