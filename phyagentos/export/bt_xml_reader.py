"""XML of BehaviorTree.CPP, version 4, as trees of this project: what `bt_xml` wrote, or a person drew in Groot2.

Upstream: a file. Downstream: `capabilities.trees.parse_tree` and the checks of every tree, whose problems then name the
line and column of the XML.
"""

import re
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import msgspec

from phyagentos.errors import Problem, format_names
from phyagentos.export.bt_xml import APART, FORMS, UNWIRED, VERSION, decode
from phyagentos.export.bt_xml_elements import EXPLICIT, Element, parse_elements
from phyagentos.export.bt_xml_equals import EXPLAINED, explain, find_equal
from phyagentos.protocol.capabilities.trees import NodeKind, Reference
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import Address, Located, read_text

_KINDS = {form.tag: kind for kind, form in FORMS.items()} | {kind.value: kind for kind in FORMS}
_OWN = re.compile(rf"[a-z][a-z0-9_/-]*({APART})?")  # ID of a tree, as `bt_xml` writes it
_SILENT = frozenset({"name", "_description", "_uid", "_fullpath", "_collapsed"})  # attributes that are no ports


def read_trees(path: Path, leaves: Collection[str] = ()) -> tuple[tuple[Located, ...], tuple[Problem, ...]]:
    """Data of the trees of a file, each value at its place in the XML; and what the tree format cannot say.

    An unknown node that holds others, and is none of the `leaves`, is a control or decorator without an equal here; a
    sequence stands in for it, so that what is below is checked too. Problems are `INVALID_VALUE` and `UNKNOWN_NAME`;
    raises DefinitionError `SYNTAX`.
    """
    reader = _Reader(str(path), leaves)
    trees = reader.read(parse_elements(read_text(path), str(path)))
    return trees, tuple(reader.problems)


TREES_MAX = 500  # of a file
_LOST = ("ports and a name", "It would be lost: remove it if that does not matter.")
_SCRIPTED = (
    "ports and a name",
    "It would be lost: write a <condition> beside this node, in a Sequence, Fallback or ReactiveSequence.",
)
_HIDDEN = dict.fromkeys(
    ("_skipIf", "_successIf", "_failureIf", "_while", "_onSuccess", "_onFailure", "_onHalted", "_post"), _SCRIPTED
) | {"_autoremap": ("each port wired by itself", "Write port='{key}' for each.")}


@dataclass(slots=True)
class _Reader:
    """Makes data of elements, and collects what has no place in it."""

    source: str
    leaves: Collection[str]
    problems: list[Problem] = field(default_factory=list)
    subtrees: dict[str, Element] = field(default_factory=dict)
    marks: dict[Address, tuple[int, int]] = field(default_factory=dict)

    def read(self, root: Element) -> tuple[Located, ...]:
        if root.tag != "root" or root.attributes.get("BTCPP_format") != VERSION:
            found = f"<{root.tag}> of format {root.attributes.get('BTCPP_format', '3 or none')}"
            self._refuse(root, found, f'<root BTCPP_format="{VERSION}">', "Groot2 saves it so.")
        trees: dict[str, Element] = {}
        for each in root.children:
            if each.tag == "TreeNodesModel":
                self.subtrees |= {_fit_name(model.id): model for model in each.children if model.tag == "SubTree"}
            elif each.tag == "include":
                file = each.attributes.get("path", "")
                hint = f"Put the trees of {file or 'that file'} into this one."
                self._refuse(each, f'<include path="{file}">', "every tree in one file", hint)
            elif each.tag != "BehaviorTree" or (name := _fit_name(each.id or Path(self.source).stem)) in trees:
                self._refuse(each, f"<{each.tag} ID={each.id!r}>", "each <BehaviorTree> once, and <TreeNodesModel>")
            else:
                trees[name] = each
        if not trees:
            self._refuse(root, "no tree", "<BehaviorTree>")
        if len(trees) > TREES_MAX:
            self._refuse(
                root, f"{len(trees)} trees", f"at most {TREES_MAX} in one file", "Import them in several files."
            )
            return ()
        return tuple(self._read_tree(name, element) for name, element in trees.items())

    def _read_tree(self, name: str, element: Element) -> Located:
        model = self.subtrees.get(name, Element("SubTree"))
        metadata = [fact for each in model.children if each.tag == "MetadataFields" for fact in each.children]
        facts = element.attributes | {key: value for fact in metadata for key, value in fact.attributes.items()}
        there = f", there {element.id!r}" if element.id not in ("", name) else ""
        origin = f"Imported from {Path(self.source).name}{there}."
        description = facts.get("description", facts.get("_description", origin))
        data: Fields = {"tree": name, "description": description}
        self.marks = {(): element.mark}
        for port in model.children:
            if group := {"input_port": "inputs", "output_port": "outputs"}.get(port.tag):
                own = port.attributes.get("name", "")
                default = decode(port.attributes["default"]) if "default" in port.attributes else None
                if isinstance(default, Reference):
                    hint = "Write it, or wire the port where the tree is used."
                    self._refuse(port, f"default={port.attributes['default']!r}", "a value", hint)
                    default = None
                body = {
                    "type": port.attributes.get("type"),
                    "description": text if (text := "".join(port.texts)).strip() else None,
                    "optional": own in facts.get("optional", "").split() or None,
                    "default": default,
                }
                data.setdefault(group, {})[own] = {key: value for key, value in body.items() if value is not None}
                self.marks[group, own] = port.mark
            elif port.tag != "MetadataFields":
                hint = "Write an input and an output, of two names."
                self._refuse(port, f"<{port.tag}>", "<input_port> or <output_port>", hint)
        if len(element.children) == 1:
            data["root"] = self._read_node(element.children[0], ("root",), name.rsplit("/", 1)[-1])
        else:
            self._refuse(element, f"{len(element.children)} nodes in a tree", "one root")
        return Located(data=data, source=self.source, marks=self.marks)

    def _read_node(self, element: Element, address: Address, default: str) -> Any:
        """Data of a node; `default` is the name that it has where none is written."""
        element = self._translate(element)
        kind, tag = _classify(element)
        key = tag if kind is NodeKind.LEAF else kind.value
        self.marks[address] = self.marks[*address, key] = element.mark
        body: dict[str, object] = self._read_values(element, kind)
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

    def _translate(self, element: Element) -> Element:
        """The element as one of ours; a sequence of its children for what has no equal."""
        name = _classify(element)[1] if element.tag in EXPLICIT else element.tag
        translated, problem = find_equal(replace(element, tag=name, id="") if element.tag in EXPLICIT else element)
        if problem:
            found, _, expected = problem.partition("; expected ")
            self._refuse(element, found, expected)
        if translated.tag != name:
            return translated
        is_foreign = name in EXPLAINED or (element.children and name not in self.leaves)
        if not is_foreign or _classify(element)[0] is not NodeKind.LEAF or name in self.leaves:
            return element
        holders = sorted(form.tag for form in FORMS.values() if form.holds)
        unknown = Problem.unknown("control", self._place(element), name, holders, found=f"<{name}>")
        hint = explain(name) or unknown.hint or "Write it with these, or as a leaf with what is below as ports."
        self.problems.append(msgspec.structs.replace(unknown, hint=hint))
        stand_in = element.children or [Element("wait", "", {"seconds": "0"}, element.mark)]
        return Element("Sequence", "", {}, element.mark, stand_in)

    def _read_children(self, element: Element, kind: NodeKind, place: Address) -> Fields:
        holds = FORMS[kind].holds if kind in FORMS else ""
        if holds != "children" and len(element.children) != bool(holds):
            expected = (
                "one"
                if holds
                else f"none; they are held by {format_names(form.tag for form in FORMS.values() if form.holds)}"
            )
            self._refuse(element, f"<{element.tag}> with {len(element.children)} nodes in it", expected)
        names, children = Counter[str](), list[Any]()
        for index, child in enumerate(element.children):
            default = _classify(child)[1].rsplit("/", 1)[-1]
            numbered = f"{default}.{names[default] + 1}" if names[default] else default  # to distinguish siblings
            name = child.attributes.get("name", numbered)
            names[default if name == numbered else name] += 1
            step = (holds, index) if holds == "children" else (holds,)
            children.append(self._read_node(child, (*place, *step), numbered))
        return {holds: children} if holds == "children" else {holds: children[0]} if holds and children else {}

    def _read_values(self, element: Element, kind: NodeKind) -> Fields:
        """Values of the attributes that are ports, as the tree format writes them."""
        own, key = FORMS[kind].number if kind in FORMS else ("", "")
        values: dict[str, object] = {}
        for name, text in element.attributes.items():
            if name in _SILENT or text.startswith(f"{{{UNWIRED}") or _is_idle(name, text):
                continue
            value = Reference(name) if text == "{=}" else decode(text)
            if name.startswith("_") or (text.startswith("{") and not isinstance(value, Reference)):
                key = f"{name}={f'{{{_fit_name(text)}}}'!r}"
                known = ("ports, whose keys are small letters, digits and _ in braces", f"Write {key}.")
                expected, hint = _HIDDEN.get(name, _LOST) if name.startswith("_") else known
                self._refuse(element, f"{name}={text!r}", expected, hint)
                continue
            values[key if name == own else name] = str(value) if isinstance(value, Reference) else value
        return values

    def _refuse(self, element: Element, found: str, expected: str, hint: str = "") -> None:
        self.problems.append(Problem("INVALID_VALUE", self._place(element), found, expected, hint))

    def _place(self, element: Element) -> str:
        return f"{self.source}:{element.mark[0]}:{element.mark[1]}"


def _is_idle(name: str, text: str) -> bool:
    """Whether a hidden attribute changes nothing: `_skipIf="false"`; a node `_while="false"` is never ticked."""
    return name.startswith("_") and text == "false" and name != "_while"


def _fit_name(name: str) -> str:
    """`MainTree` as `main_tree`, `Re-Zero / Sensors` as `re_zero_sensors`; what `bt_xml` wrote as it was."""
    if _OWN.fullmatch(name):
        return name.removesuffix(APART).replace("-", "/")
    apart = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name).lower()
    fit = re.sub(r"[^a-z0-9]+", "_", apart).strip("_")
    return fit if fit[:1].isalpha() else f"tree_{fit}".strip("_")


def _classify(element: Element) -> tuple[NodeKind, str]:
    """Kind of a node, and the name of the leaf or tree that it stands for; of others the name of the kind."""
    tag = element.id if element.tag in EXPLICIT and element.id else element.tag
    kind = _KINDS.get(tag, NodeKind.LEAF)
    return kind, tag if kind is NodeKind.LEAF else _fit_name(element.id) if kind is NodeKind.SUBTREE else kind.value
