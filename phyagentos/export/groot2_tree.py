"""A tree in the terms of Groot2's live view: each subtree once for each place that has it, its nodes numbered, states.

As `Groot2Publisher` of BehaviorTree.CPP 4 sends it, protocol 2. https://www.behaviortree.dev/docs/groot/intro
"""

import struct
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from phyagentos.export.bt_xml import Names, NodeModel, close_root, open_root, write_element
from phyagentos.protocol.capabilities.trees import Node, NodeKind, Tree
from phyagentos.protocol.sessions.trace import TraceEvent

STATE = struct.Struct("<HB")  # number of a node, and its state
IDLE, STATES = 0, {"running": 1, "success": 2, "failure": 3}
IDLE_AFTER = 10  # is added to the state that a node had before it was halted


@dataclass(slots=True)
class LiveTree:
    """A tree and the states of its nodes.

    Attributes:
        xml: As `Groot2Publisher` writes it.
        paths: Of each node the path in traces, in the order of their numbers, which begin at 1; a subtree and its root
            have the same.
    """

    xml: str
    paths: tuple[str, ...]
    _states: dict[str, int] = field(default_factory=dict)

    def follow(self, events: Iterable[TraceEvent]) -> None:
        """The states after all that happened so far."""
        self._states.clear()
        for each in events:
            before = self._states.get(each.path, IDLE)
            halted = before if before >= IDLE_AFTER or before == IDLE else before + IDLE_AFTER
            self._states[each.path] = STATES.get(each.status.lower(), halted)

    def encode(self) -> bytes:
        """The state of every node."""
        numbered = enumerate(self.paths, 1)
        return b"".join(STATE.pack(number, self._states.get(path, IDLE)) for number, path in numbered)


def make_live_tree(trees: Mapping[str, Tree], leaves: Mapping[str, NodeModel]) -> LiveTree:
    """A tree, the first of `trees`, with its subtrees; nothing has happened yet."""
    names, paths = Names.of([*trees.values()], leaves), list[str]()
    root = open_root(names)

    def write_tree(tree: Tree, path: str, place: str) -> None:
        element = ET.SubElement(root, "BehaviorTree", {"ID": names.ids[tree.header.tree], "_fullpath": place})
        write_node(element, tree.root, path, place)

    def write_node(parent: ET.Element, node: Node, path: str, place: str) -> None:
        element = write_element(parent, node, names)
        paths.append(path)
        element.set("_uid", str(len(paths)))
        if node.kind is NodeKind.SUBTREE:
            inside = f"{place}/{node.name}".removeprefix("/")
            element.set("_fullpath", inside)
            write_tree(trees[node.type], path, inside)
        for child in node.children:
            write_node(element, child, f"{path}/{child.name}", place)

    main = next(iter(trees.values()))
    write_tree(main, main.root.name, "")
    return LiveTree(close_root(root, names), tuple(paths))
