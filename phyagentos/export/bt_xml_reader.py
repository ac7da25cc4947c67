"""XML of BehaviorTree.CPP, version 4, as trees of this project: what `bt_xml` wrote, or a person drew in Groot2.

Upstream: a file. Downstream: `capabilities.trees.parse_tree` and the checks of every tree, whose problems then name the
line and column of the XML.
"""

import re
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.parsers import expat

from phyagentos.errors import DefinitionError, Problem, format_names
from phyagentos.export.bt_xml import FORMS, VERSION, decode
from phyagentos.protocol.capabilities.trees import NodeKind, Reference
from phyagentos.protocol.documents.schema import Address, Located, read_text
from phyagentos.protocol.documents.yaml_bounds import DEPTH_MAX, TOO_DEEP

_KINDS = {form.tag: kind for kind, form in FORMS.items()} | {kind.value: kind for kind in FORMS}
_EXPLICIT = frozenset({"Action", "Condition", "Control", "Decorator"})  # <Action ID="move_to"/> is <move_to/>
_SILENT = frozenset({"ID", "name", "_description", "_uid", "_fullpath"})  # attributes that are no ports
_HOLDING = [form.tag for form in FORMS.values() if form.holds]
_GROUPS = {"input_port": "inputs", "output_port": "outputs"}


@dataclass(frozen=True, slots=True)
class Element:
    """One element of an XML file, and where it begins: line and column, counted from 1."""

    tag: str
    attributes: dict[str, str]
    mark: tuple[int, int]
    children: list["Element"] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)

    @property
    def id(self) -> str:
        """Its attribute `ID`; empty without."""
        return self.attributes.get("ID", "")


def read_trees(path: Path) -> tuple[tuple[Located, ...], tuple[Problem, ...]]:
    """The trees of a file as data of the tree format, the main one first, each value at its place in the XML.

    Problems are `INVALID_VALUE` for what the tree format cannot say, and `UNKNOWN_TREE`; raises DefinitionError
    `XML_SYNTAX`.
    """
    reader = _Reader(str(path))
    trees = reader.read(_parse(read_text(path), str(path)))
    return trees, tuple(reader.problems)


def _parse(text: str, source: str) -> Element:
    parser = expat.ParserCreate()
    opened = [Element("", {}, (1, 1))]

    def refuse(found: str) -> DefinitionError:
        place = f"{source}:{parser.CurrentLineNumber}:{parser.CurrentColumnNumber + 1}"
        return DefinitionError.of("XML_SYNTAX", place, found, "well-formed XML without DOCTYPE")

    def begin(tag: str, attributes: dict[str, str]) -> None:
        if len(opened) > DEPTH_MAX:
            raise refuse(TOO_DEEP)
        element = Element(tag, attributes, (parser.CurrentLineNumber, parser.CurrentColumnNumber + 1))
        opened[-1].children.append(element)
        opened.append(element)

    def add_text(data: str) -> None:
        opened[-1].texts.append(data)

    def forbid(*_: object) -> None:
        raise refuse("a DOCTYPE")

    parser.StartElementHandler, parser.EndElementHandler = begin, lambda _: opened.pop()
    parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = add_text, forbid
    try:
        parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        raise refuse(expat.ErrorString(error.code)) from error
    return opened[0].children[0]


class _Reader:
    """Makes data of elements, and collects what has no place in it."""

    def __init__(self, source: str) -> None:
        self.problems: list[Problem] = []
        self._source = source
        self._subtrees: dict[str, Element] = {}
        self._marks: dict[Address, tuple[int, int]] = {}

    def read(self, root: Element) -> tuple[Located, ...]:
        if root.tag != "root" or root.attributes.get("BTCPP_format") != VERSION:
            found = f"<{root.tag}> of format {root.attributes.get('BTCPP_format', '3 or none')}"
            self._refuse(root, found, f'<root BTCPP_format="{VERSION}">', "Groot2 saves it so.")
        self._rename_trees(root)
        trees: dict[str, Element] = {}
        for each in root.children:
            if each.tag == "TreeNodesModel":
                self._subtrees |= {model.id: model for model in each.children if model.tag == "SubTree"}
            elif each.tag != "BehaviorTree" or each.id in trees:
                found = f"<{each.tag} ID={each.id!r}>"
                self._refuse(each, found, "each <BehaviorTree> once, and <TreeNodesModel>; nothing is included")
            else:
                trees[each.id] = each
        main = _fit_name(root.attributes.get("main_tree_to_execute", next(iter(trees), "")))
        if main not in trees:
            self.problems.append(Problem.unknown("UNKNOWN_TREE", self._place(root), main, trees))
        read = [self._read_tree(each) for each in trees.values()]
        return tuple(sorted(read, key=lambda tree: tree.data["tree"] != main))

    def _rename_trees(self, element: Element) -> None:
        """Refuse names that no tree file can have; the rest is checked under names that it can."""
        if element.tag in ("BehaviorTree", "SubTree"):
            name, fit = element.id, _fit_name(element.id)
            element.attributes["ID"] = fit
            if fit != name and element.tag == "BehaviorTree":
                self._refuse(
                    element, f"the tree {name!r}", "small letters, digits and underscores", f"Call it {fit!r}."
                )
        for child in element.children:
            self._rename_trees(child)

    def _read_tree(self, element: Element) -> Located:
        model = self._subtrees.get(element.id, Element("SubTree", {}, element.mark))
        metadata = [fact for each in model.children if each.tag == "MetadataFields" for fact in each.children]
        facts = {key: value for fact in metadata for key, value in fact.attributes.items()}
        description = facts.get("description") or element.attributes.get("_description")
        data: dict[str, Any] = {"tree": element.id}
        data["description"] = description or f"Imported from {Path(self._source).name}."
        self._marks = {(): element.mark}
        for port in model.children:
            if group := _GROUPS.get(port.tag):
                body = _read_port(port, is_optional=port.attributes.get("name") in facts.get("optional", "").split())
                data.setdefault(group, {})[port.attributes.get("name", "")] = body
                self._marks[group, port.attributes.get("name", "")] = port.mark
            elif port.tag != "MetadataFields":
                self._refuse(port, f"<{port.tag}>", "<input_port> or <output_port>")
        if len(element.children) == 1:
            data["root"] = self._read_node(element.children[0], ("root",), element.id.rsplit("/", 1)[-1])
        else:
            self._refuse(element, f"{len(element.children)} nodes in a tree", "one root")
        return Located(data=data, source=self._source, marks=self._marks)

    def _read_node(self, element: Element, address: Address, default: str) -> Any:
        """Data of a node; `default` is the name that it has where none is written."""
        kind, tag = _classify(element)
        key = tag if kind is NodeKind.LEAF else kind.value
        self._marks[address] = self._marks[*address, key] = element.mark
        body: dict[str, Any] = self._read_values(element, kind)
        name = element.attributes.get("name", default)
        if kind is NodeKind.CONDITION:
            if name != default or body.keys() != {"predicate"}:
                self._refuse(element, f"a condition with {element.attributes}", "a predicate, and no name of its own")
            return {key: body.get("predicate")}
        if kind is NodeKind.SUBTREE:
            body = {"tree": tag} | ({"with": body} if body else {})
        body |= {"name": name} if name != default else {}
        body |= self._read_children(element, kind, (*address, key))
        return {key: body} if body or kind is not NodeKind.LEAF else key

    def _read_children(self, element: Element, kind: NodeKind, place: Address) -> dict[str, Any]:
        holds = FORMS[kind].holds if kind in FORMS else ""
        found = f"<{element.tag}> with {len(element.children)} nodes in it"
        if not holds and element.children:
            self._refuse(element, found, f"none; they are held by {format_names(_HOLDING)}")
        elif holds == "child" and len(element.children) != 1:
            self._refuse(element, found, "one")
        names: Counter[str] = Counter()
        children = []
        for index, child in enumerate(element.children):
            default = _classify(child)[1].rsplit("/", 1)[-1]
            numbered = f"{default}.{names[default] + 1}" if names[default] else default  # as siblings are told apart
            name = child.attributes.get("name", numbered)
            names[default if name == numbered else name] += 1
            step = (holds, index) if holds == "children" else (holds,)
            children.append(self._read_node(child, (*place, *step), numbered))
        return {holds: children} if holds == "children" else {holds: children[0]} if holds and children else {}

    def _read_values(self, element: Element, kind: NodeKind) -> dict[str, Any]:
        """Values of the attributes that are ports, as the tree format writes them."""
        own, key = FORMS[kind].number if kind in FORMS else ("", "")
        values: dict[str, Any] = {}
        for name, text in element.attributes.items():
            if name in _SILENT or (name == "_autoremap" and text in {"false", "0"}):
                continue
            value = Reference(name) if text == "{=}" else decode(text)
            if name.startswith("_"):
                self._refuse(element, f"{name}={text!r}", "no scripts and no remapping of all: nodes, and keys by name")
                continue
            if text.startswith("{") and not isinstance(value, Reference):
                self._refuse(element, f"{name}={text!r}", "a key of small letters, digits and underscores in braces")
            values[key if name == own else name] = f"${value.key}" if isinstance(value, Reference) else value
        return values

    def _place(self, element: Element) -> str:
        return f"{self._source}:{element.mark[0]}:{element.mark[1]}"

    def _refuse(self, element: Element, found: str, expected: str, hint: str = "") -> None:
        self.problems.append(Problem("INVALID_VALUE", self._place(element), found, expected, hint))


def _fit_name(name: str) -> str:
    """`MainTree` as `main_tree`; what is a name of a tree as it stands."""
    apart = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()
    return re.sub(r"^[^a-z]+", "", re.sub(r"[^a-z0-9_/]+", "_", apart)) or "tree"


def _classify(element: Element) -> tuple[NodeKind, str]:
    """Kind of a node, and the name of the leaf or tree that it stands for; of others the name of the kind."""
    tag = element.id if element.tag in _EXPLICIT and element.id else element.tag
    kind = _KINDS.get(tag, NodeKind.LEAF)
    return kind, tag if kind is NodeKind.LEAF else element.id if kind is NodeKind.SUBTREE else kind.value


def _read_port(port: Element, *, is_optional: bool) -> dict[str, Any]:
    """An input or output of a tree, as the tree format writes it."""
    kind, default = port.attributes.get("type"), port.attributes.get("default")
    body = {
        "type": kind,
        "description": "".join(port.texts).strip() or None,
        "optional": is_optional or None,
        "default": decode(default) if default is not None else None,
    }
    return {key: value for key, value in body.items() if value is not None}
