"""Behaviour trees as XML of BehaviorTree.CPP, version 4, with a TreeNodesModel: what Groot2 shows and edits.

Nodes that mean the same in version 4 bear its names (`Sequence`, `RetryUntilSuccessful`). The others, `timeout` in
simulated time among them, are declared as custom nodes under ours. `bt_xml_reader` makes the same trees of the file.
https://www.behaviortree.dev/docs/learn-the-basics/xml_format
"""

import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from phyagentos.protocol.capabilities.trees import REFERENCE, Node, NodeKind, Reference, Tree, TreeHeader

VERSION = "4"
_KEY = re.compile(r"^\{([a-z][a-z0-9_]*)\}$")
_NAMED = re.compile(r"\$\(([a-z][a-z0-9_]*)\)")  # `${name}` of a predicate: other readers refuse braces inside a text
UNWIRED = "_unwired_"  # begins a key that nothing else has
APART = "-Tree"  # after the name of a tree that a leaf has, too; no name of ours has hyphens or capitals
_BRACES = {"{": "\\u007b", "}": "\\u007d", "$": "\\u0024"}


@dataclass(frozen=True, slots=True)
class Port:
    """A port: `input_port` or `output_port`, its type in words of the tree format, and its default."""

    direction: str = "input_port"
    type: str = ""
    default: Any = None
    description: str = ""


@dataclass(frozen=True, slots=True)
class NodeModel:
    """What TreeNodesModel says of an `Action`, `Condition`, `Control`, `Decorator` or `SubTree`.

    Attributes:
        optional: Inputs that have no default and may be left unwired.
    """

    kind: str
    ports: Mapping[str, Port] = field(default_factory=dict)
    description: str = ""
    optional: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Form:
    """How one kind of node is written.

    Attributes:
        holds: `children`, one `child`, or nothing.
        number: The attribute and the key of the YAML for its attempts, times or seconds.
        model: Of a kind that version 4 does not have.
    """

    tag: str
    holds: str = ""
    number: tuple[str, str] = ("", "")
    model: NodeModel | None = None


_SECONDS, _IN_SECONDS = ("seconds", "seconds"), {"seconds": Port(type="number", description="Of simulated time.")}
_POLICY = {"policy": Port(type="string", default="all", description="all or one.")}
_EACH = {"each": Port("output_port", description="One after the other."), "in": Port(description="A list.")}
_PREDICATE = {"predicate": Port(type="string", description="$(name) stands for the value of a key.")}
FORMS: dict[NodeKind, Form] = {
    NodeKind.SEQUENCE: Form("Sequence", "children"),
    NodeKind.FALLBACK: Form("Fallback", "children"),
    NodeKind.REACTIVE_SEQUENCE: Form("ReactiveSequence", "children"),
    NodeKind.REACTIVE_FALLBACK: Form("ReactiveFallback", "children"),
    NodeKind.PARALLEL: Form("parallel", "children", model=NodeModel("Control", _POLICY)),
    NodeKind.RETRY: Form("RetryUntilSuccessful", "child", ("num_attempts", "attempts")),
    NodeKind.REPEAT: Form("Repeat", "child", ("num_cycles", "times")),
    NodeKind.FOR_EACH: Form("for_each", "child", model=NodeModel("Decorator", _EACH)),
    NodeKind.TIMEOUT: Form("timeout", "child", _SECONDS, NodeModel("Decorator", _IN_SECONDS)),
    NodeKind.COOLDOWN: Form("cooldown", "child", _SECONDS, NodeModel("Decorator", _IN_SECONDS)),
    NodeKind.INVERT: Form("Inverter", "child"),
    NodeKind.CONDITION: Form("condition", model=NodeModel("Condition", _PREDICATE)),
    NodeKind.SUBTREE: Form("SubTree"),
}


def describe_tree(header: TreeHeader) -> NodeModel:
    """The model of a tree as a subtree of others."""
    ports = {
        name: Port(direction, port.type, port.default, port.description)
        for direction, group in (("input_port", header.inputs), ("output_port", header.outputs))
        for name, port in group.items()
    }
    optional = tuple(name for name, port in header.inputs.items() if port.optional)
    return NodeModel("SubTree", ports, header.description, optional)


@dataclass(frozen=True, slots=True)
class Names:
    """What a file of trees declares: the IDs of trees by their names, subtrees by ID, and other nodes by tag."""

    ids: Mapping[str, str]
    subtrees: Mapping[str, NodeModel]
    models: Mapping[str, NodeModel]

    @classmethod
    def of(cls, trees: Sequence[Tree], leaves: Mapping[str, NodeModel]) -> "Names":
        """Those of trees, with the leaves that the model offers."""
        models = {form.tag: form.model for form in FORMS.values() if form.model is not None} | dict(leaves)
        ids = {name: name.replace("/", "-") + APART * (name in models) for name in (tree.header.tree for tree in trees)}
        return cls(ids, {ids[tree.header.tree]: describe_tree(tree.header) for tree in trees}, models)


def render_trees(trees: Sequence[Tree], leaves: Mapping[str, NodeModel]) -> str:
    """One file of trees, the first of which is the main one; `leaves` are those that the model offers."""
    names = Names.of(trees, leaves)
    root = open_root(names)
    for tree in trees:
        _write_node(ET.SubElement(root, "BehaviorTree", {"ID": names.ids[tree.header.tree]}), tree.root, names)
    return close_root(root, names)


def open_root(names: Names) -> ET.Element:
    """The element of a file, whose main tree is the first."""
    return ET.Element("root", {"BTCPP_format": VERSION, "main_tree_to_execute": next(iter(names.ids.values()))})


def close_root(root: ET.Element, names: Names) -> str:
    """The file, with its model."""
    model = ET.SubElement(root, "TreeNodesModel")
    for name, node in (*names.models.items(), *names.subtrees.items()):
        _write_model(model, name, node)
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'


def _write_node(parent: ET.Element, node: Node, names: Names) -> None:
    element = write_element(parent, node, names)
    for child in node.children:
        _write_node(element, child, names)


def write_element(parent: ET.Element, node: Node, names: Names) -> ET.Element:
    """One node, without its children."""
    form = FORMS.get(node.kind, Form(node.type))
    element = ET.SubElement(parent, form.tag, {"name": node.name})
    for name, value in _list_values(node, form).items():
        element.set(name, encode(value))
    if node.kind is NodeKind.SUBTREE:
        element.set("ID", names.ids[node.type])
        for name, port in names.subtrees[names.ids[node.type]].ports.items():
            if name not in node.wiring and port.default is None:  # version 4 wants every port wired
                element.set(name, f"{{{UNWIRED}{re.sub(r'[^a-z0-9]', '_', f'{node.name}_{node.type}_{name}')}}}")
    return element


def _list_values(node: Node, form: Form) -> Mapping[str, Any]:
    """Attribute -> value, of a node."""
    if node.kind is NodeKind.CONDITION:
        return {"predicate": node.text}
    if node.kind is NodeKind.PARALLEL:
        return {"policy": node.policy}
    amount = int(node.amount) if node.amount.is_integer() else node.amount
    return {form.number[0]: amount} if form.number[0] else node.wiring


def _write_model(parent: ET.Element, name: str, model: NodeModel) -> None:
    element = ET.SubElement(parent, model.kind, {"ID": name})
    for port_name, port in model.ports.items():
        default = {"default": encode(port.default)} if port.default is not None else {}
        written = ET.SubElement(element, port.direction, {"name": port_name, "type": port.type} | default)
        written.text = port.description or None
    facts = {"description": model.description, "optional": " ".join(model.optional)}
    if facts := {key: text for key, text in facts.items() if text}:
        ET.SubElement(ET.SubElement(element, "MetadataFields"), "Metadata", facts)


def encode(value: object) -> str:
    """A value of a port as an attribute: `{key}`, a text as it is unless it could be JSON, anything else as JSON."""
    if isinstance(value, Reference):
        return f"{{{value.key}}}"
    if isinstance(value, str):
        text = REFERENCE.sub(r"$(\1)", value)
        if not set(text) & set("{}") and decode(text) == value:
            return text
    return "".join(_BRACES.get(letter, letter) for letter in json.dumps(value, ensure_ascii=False))


def decode(text: str) -> Any:
    """The value as `encode` has written it."""
    if key := _KEY.match(text):
        return Reference(key[1])
    try:
        return json.loads(text)
    except ValueError:
        return _NAMED.sub(r"${\1}", text)
