"""A behaviour tree as Mermaid and as SVG, from its file and the declared ports alone."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from phyagentos.errors import DefinitionError
from phyagentos.pictures.layers import draw_layers
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.trees import Node, NodeKind, Reference, Tree, find_oversize, read_tree
from phyagentos.protocol.documents.flowchart import Arrow, Box, render_flowchart
from phyagentos.protocol.sessions.trace import TraceEvent

SYMBOLS = {
    "sequence": "→",
    "fallback": "?",
    "reactive_sequence": "⟳→",
    "reactive_fallback": "⟳?",
    "parallel": "⇉",
    "retry": "↻",
    "repeat": "↺",
    "for_each": "∀",
    "timeout": "⏱",
    "cooldown": "❄",
    "invert": "¬",
    "condition": "◇",
    "subtree": "▣",
}


@dataclass(frozen=True, slots=True)
class Drawing:
    """One node of a drawn tree.

    Attributes:
        kind: `sequence`, `fallback`, ..., `subtree`, or the name of a leaf.
        id: As authored, and in the paths of a trace; may equal the kind.
        name: The same with what its kind adds.
        ports: `port = value` texts.
    """

    kind: str
    id: str
    name: str
    ports: tuple[str, ...] = ()
    children: tuple["Drawing", ...] = ()

    @property
    def label(self) -> str:
        """Symbol and name on one line."""
        symbol = SYMBOLS.get(self.kind, "")
        name = self.name if self.name == self.kind or symbol else f"{self.name} · {self.kind}"
        return f"{symbol} {name}".strip()

    @property
    def family(self) -> str:
        """`leaf`, `subtree` or `control`."""
        if self.kind == "subtree":
            return "subtree"
        return "control" if self.kind in SYMBOLS else "leaf"


@dataclass(slots=True)
class TickingNode:
    """A node of a tree with what became of it.

    Attributes:
        status: As its last event says; `INVALID` when it was reset, empty before its first tick.
        event: Its last event with a status of its own.
    """

    drawing: Drawing
    path: str
    status: str = ""
    event: TraceEvent | None = None
    children: list["TickingNode"] = field(default_factory=list)


def draw_tree(tree: Tree, library: Library) -> Drawing:
    """A tree and the subtrees it names.

    Raises:
        DefinitionError: With every problem of the first file that has any; `CYCLE`, `TOO_LARGE`.
    """
    if (oversize := find_oversize(tree, library)) is not None:
        raise DefinitionError(oversize[1])
    return _draw_tree(tree, library, (tree.header.tree,))


def tick(drawing: Drawing, trace: Iterable[TraceEvent]) -> TickingNode:
    """A tree with the status of each node at the end of a trace."""
    nodes: dict[str, TickingNode] = {}

    def place(part: Drawing, above: str) -> TickingNode:
        path = f"{above}/{part.id}".lstrip("/")
        nodes[path] = node = TickingNode(part, path)
        inner = part.children[0].children if part.kind == "subtree" else part.children  # a trace names it once
        node.children = [place(child, path) for child in inner]
        return node

    root = place(drawing, "")
    for event in trace:
        if (node := nodes.get(event.path)) is not None:
            node.status = event.status
            node.event = node.event if event.status == "INVALID" else event
    return root


def _draw_tree(tree: Tree, library: Library, inside: tuple[str, ...]) -> Drawing:
    inputs = tuple(f"{name}: {port.type}" for name, port in tree.header.inputs.items())
    root = _draw_node(tree.root, tree, library, inside)
    return Drawing(kind="subtree", id=tree.header.tree, name=tree.header.tree, ports=inputs, children=(root,))


def _draw_node(node: Node, tree: Tree, library: Library, inside: tuple[str, ...]) -> Drawing:
    ports = tuple(f"{port} = {_show(value)}" for port, value in node.wiring.items())
    if node.kind is NodeKind.SUBTREE:
        if node.type in inside:
            way = " -> ".join((*inside, node.type))
            raise DefinitionError.of("CYCLE", tree.located.address_of(node.address), way, hint="Break the cycle.")
        below = _draw_tree(read_tree(library.get_tree(node.type)), library, (*inside, node.type))
        return Drawing(kind="subtree", id=node.name, name=node.name, ports=ports, children=below.children)
    children = tuple(_draw_node(child, tree, library, inside) for child in node.children)
    kind = node.type if node.kind is NodeKind.LEAF else node.kind.value
    return Drawing(kind=kind, id=node.name, name=_name_of(node), ports=ports, children=children)


def _name_of(node: Node) -> str:
    """The node's name with what its kind adds: attempts, seconds, policy, predicate."""
    match node.kind:
        case NodeKind.RETRY | NodeKind.REPEAT:
            return f"{node.name} × {node.amount:.0f}"
        case NodeKind.TIMEOUT | NodeKind.COOLDOWN:
            return f"{node.name} {node.amount:g} s"
        case NodeKind.PARALLEL:
            return f"{node.name} ({node.policy})"
        case NodeKind.CONDITION:
            return node.text
        case _:
            return node.name


def _show(value: object) -> str:
    return f"${value.key}" if isinstance(value, Reference) else str(value)


def render_mermaid(root: Drawing) -> str:
    """A Mermaid flowchart, top down."""
    return render_flowchart(*_list_parts(root))


def render_svg(root: Drawing) -> str:
    """A stand-alone SVG: no program is needed to look at it."""
    return draw_layers(*_list_parts(root), f"Behaviour tree {root.name}")


def _list_parts(root: Drawing) -> tuple[list[Box], list[Arrow]]:
    boxes: list[Box] = []
    arrows: list[Arrow] = []

    def add(node: Drawing) -> str:
        hint = ", ".join(node.ports)
        box = Box(name=str(len(boxes)), title=node.label, below=node.ports, kind=node.family, hint=hint)
        boxes.append(box)
        below = [add(child) for child in node.children]
        arrows.extend(Arrow(box.name, child) for child in below)
        return box.name

    add(root)
    return boxes, arrows
