"""One flat goal graph out of an authored file: parameters get their values, included graphs become nodes.

Works on data, before its form is checked: so a parameter may stand for anything, and checks, compiler and journal know
neither parameters nor includes. Each value keeps the place in its own file. Node `red` of include `front` becomes
`front-red`; like those of a fan-out, such a name is safe in ids and never equal to an authored one.
"""

import itertools
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pydantic

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.checks import iter_mismatches
from phyagentos.agent.goals.expansion import iter_strings, substitute_value
from phyagentos.agent.goals.spec import NAME_MAX, NODE_NAME, REFERENCE, AnyOf, GoalSpec, GraphParameter, Include
from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import Address, Located, read_yaml, salvage, suggest_name

INCLUDES_MAX = 100  # of one graph: files that include the next one twice double in number with every level

Item = tuple[Any, tuple[Located, Address]]  # a value, and where it is written

_OWN = frozenset({"parameters", "sessions"})
_SHARED = ("scene", "worlds", "described", "interchangeable")
_TAKEN_OVER = frozenset({"timeout_s", "max_replans", "lookahead"})  # of `defaults`, by the nodes of an include


@dataclass(frozen=True, kw_only=True)
class _Scope:
    """What an include gives to the nodes of its graph."""

    prefix: str = ""
    above: tuple[str, ...] = ()  # files that include it, the first one first
    edges: tuple[Item, ...] = ()  # to nodes that wait for no other; those on failure to each
    holds: tuple[Item, ...] = ()
    defaults: Mapping[str, Any] = field(default_factory=dict)


class Composer:
    """Composes one file, and keeps the problems found so far.

    Attributes:
        flat: The graph without includes and without references to parameters; its form is not checked yet.
        bundle: As authored, with included graphs in their places, so that it needs no other file.
        groups: Include, or choice among alternatives -> its nodes.
    """

    def __init__(self, located: Located, catalogue: Catalogue) -> None:
        self.flat, self.bundle, self.problems = located, located.data, list[Problem]()
        self.groups: dict[str, tuple[str, ...]] = {}
        self._catalogue, self._includes = catalogue, 0
        if isinstance(located.data, dict) and isinstance(located.data.get("sessions"), dict):
            head, values = self._bind(located, {})
            if self.problems and located.origins:  # a value that was given: what uses it says the same
                raise DefinitionError(self.problems)
            self.flat = replace(located, data=head | {"sessions": {}}, origins=dict(located.origins))
            self.bundle = self._add(located, values, _Scope())

    def _bind(self, located: Located, given: Mapping[str, Item]) -> tuple[Fields, Fields]:
        """All but the sessions with values for parameters, and the values; the default stands for an unsound one."""
        data, values = located.data, {}
        kinds = self._catalogue.find_kinds(str(data.get("scene"))) if "parameters" in data else None
        kinds = kinds and kinds | dict.fromkeys(as_dict(data.get("described")), "")
        for name, parameter in _iter_parameters(located):
            own: Item = (parameter.default, (located, ("parameters", name, "default")))
            value, (where, path) = given.get(name, own)
            is_output = any(REFERENCE.search(text) for _, text in iter_strings(value))  # checked where it is used
            found = [] if is_output else list(iter_mismatches(where, path, parameter, value, kinds))
            self.problems += found
            values[name] = parameter.default if found else value
        head = {key: item if key in _OWN else substitute_value(item, values) for key, item in data.items()}
        for path, text in iter_strings({key: item for key, item in head.items() if key not in _OWN}):
            self._check_references(located, path, text, values)
        return head, values

    def _check_references(self, located: Located, path: Address, text: str, possible: Iterable[str]) -> None:
        """Outside of nodes only to parameters, in arguments of an include also to outputs of nodes."""
        for match in REFERENCE.finditer(text):
            if path[0] != "sessions" or ".outputs." not in match[1]:
                self.problems.append(located.unknown("reference", path, match[1], possible, match[0]))

    def _add(self, located: Located, values: Mapping[str, object], scope: _Scope) -> Fields:
        """Adds the nodes of a graph; returns its bundle."""
        bundled = dict(located.data["sessions"])
        for name, authored in located.data["sessions"].items():
            path, full = ("sessions", name), f"{scope.prefix}{name}"
            if len(str(name)) > NAME_MAX or not re.fullmatch(NODE_NAME, str(name)):
                expected = f"at most {NAME_MAX} lower-case letters, digits and underscores, beginning with a letter"
                self.problems.append(
                    located.problem("INVALID_VALUE", path, repr(name), expected, suggest_name(str(name), NODE_NAME))
                )
            is_plain = not isinstance(authored, dict) or not (scope.prefix or values)
            node = authored if is_plain else _fill(_lengthen(authored, scope.prefix), values)
            alone = replace(located, data={"sessions": {name: node}})
            if "include" in as_dict(node):
                for inside, text in iter_strings(node.get("with"), (*path, "with")):
                    self._check_references(located, inside, text, values)
                bundled[name] = bundled[name] | {"include": self._include(alone, path, scope) or node["include"]}
            elif "any_of" in as_dict(node):
                self._add_alternatives(alone, path, full, scope)
            else:
                self._add_node(located, path, full, node, scope)
        return as_dict(located.data) | {"sessions": bundled}

    def _add_node(self, located: Located, path: Address, full: str, node: object, scope: _Scope) -> None:
        """Adds one node, with what its include gives to it."""
        self.flat.data["sessions"][full] = node
        if scope.prefix:
            self.flat.origins["sessions", full] = (located, path)
        if scope.prefix and isinstance(node, dict):
            self.flat.data["sessions"][full] = node = {**scope.defaults, **node}
            edges = [each for each in scope.edges if each[0]["on"] == "failure" or not node.get("after")]
            self._extend(node, ("sessions", full, "after"), edges)
            self._extend(node, ("sessions", full, "hold"), scope.holds)

    def _add_alternatives(self, located: Located, path: Address, full: str, scope: _Scope) -> None:
        """Adds a node for each alternative; a later one waits for the failure of all before it."""
        spec, problems = salvage(AnyOf, located, path)
        self.problems += problems
        names = [f"{full}-{number}" for number in range(1, len(spec.any_of) + 1)] if spec is not None else []
        self.groups[full] = tuple(names)
        authored = located.data["sessions"][path[1]]
        for index, name in enumerate(names):
            where, node = (*path, "any_of", index), dict(authored["any_of"][index])
            failures: list[Item] = [({"node": each, "on": "failure"}, (located, where)) for each in names[:index]]
            for key in ("after", "when", "requires", "hold", "accept"):
                shared = [(item, (located, (*path, key, place))) for place, item in enumerate(authored.get(key) or ())]
                self._extend(node, ("sessions", name, key), [*shared, *(failures if key == "after" else ())])
            self._add_node(located, where, name, node, scope)
            self.flat.origins["sessions", name] = (located, where)

    def _include(self, outer: Located, path: Address, scope: _Scope) -> Any:
        """Adds the nodes of one include; returns the bundle of its graph."""
        spec, problems = salvage(Include, outer, path)
        self.problems += problems
        self._includes += 1
        group = f"{scope.prefix}{path[1]}"
        self.groups[group] = ()
        if spec is None or (inner := self._open(spec.include, outer, (*path, "include"), scope.above)) is None:
            return None
        own = dict(_iter_parameters(inner))
        for key in spec.arguments.keys() - own.keys():
            self.problems.append(outer.unknown("parameter", (*path, "with", key), key, own))
        edges = [(each.model_dump(), (outer, (*path, "after", index))) for index, each in enumerate(spec.after)]
        edges += [each for each in scope.edges if not edges or each[0]["on"] == "failure"]
        scope = replace(scope, prefix=f"{group}-", above=(*scope.above, outer.source), edges=tuple(edges))
        before = len(self.flat.data["sessions"])
        bundle = self._merge(inner, spec, outer, path, scope)
        self.groups[group] = tuple(itertools.islice(self.flat.data["sessions"], before, None))
        return bundle

    def _open(self, include: Any, outer: Located, path: Address, above: Sequence[str]) -> Located | None:
        """The included graph; None, with the problem noted, when there is none."""
        if isinstance(include, dict):
            return Located(data=include, source=outer.source, origins={(): (outer, path)})
        folders = [*(root / "goal_graphs" for root in reversed(Library.open().roots)), Path(outer.source).parent]
        known = {file.stem: file.resolve() for folder in folders for file in folder.glob("*.yaml")}
        if include not in known:
            self.problems.append(outer.unknown("file", path, include, known))
            return None
        files = [Path(each).resolve() for each in (*above, outer.source)]
        if known[include] in files or self._includes > INCLUDES_MAX:
            names = [each.stem for each in (*files, known[include]) if known[include] in files]
            found = " -> ".join(names[names.index(include) :]) if names else f"more than {INCLUDES_MAX} includes"
            self.problems.append(outer.problem("CYCLE", path, found, "no way back", "Remove one of these includes."))
            return None
        return read_yaml(known[include])

    def _merge(self, inner: Located, spec: Include, outer: Located, path: Address, scope: _Scope) -> Any:
        """Takes over the nodes of an included graph, and what they need; returns its bundle."""
        given: dict[str, Item] = {key: (item, (outer, (*path, "with", key))) for key, item in spec.arguments.items()}
        sessions = as_dict(inner.data).get("sessions")
        has_nodes = isinstance(sessions, dict) and bool(sessions)
        head, values = self._bind(inner, given) if has_nodes else (inner.data, {})
        some = head | {"sessions": {"node": {"skill": ""}}} if has_nodes else head  # the nodes are checked later
        checked, problems = salvage(GoalSpec, replace(inner, data=some))
        self.problems += problems
        if checked is None or not has_nodes:
            return None
        data = self.flat.data
        for key in _SHARED:
            if head.get(key) not in (None, data.get(key)):
                expected = f"{data.get(key)!r}, as in the including graph"
                self.problems.append(inner.problem("INVALID_VALUE", (key,), repr(head[key]), expected))
        data["targets"] = checked.targets | as_dict(data.get("targets"))
        accept: list[Item] = [(text, (inner, ("accept", index))) for index, text in enumerate(checked.accept)]
        if spec.accept is not None:
            accept = [(text, (outer, (*path, "accept", index))) for index, text in enumerate(spec.accept)]
        elif any(edge["on"] == "failure" for edge, _ in scope.edges):  # it may not be taken
            accept = []
        self._extend(data, ("accept",), accept)
        holds = [(text, (inner, ("constraints", index))) for index, text in enumerate(checked.constraints)]
        own = {key: head["defaults"][key] for key in _TAKEN_OVER & checked.defaults.model_fields_set}
        scope = replace(scope, holds=(*scope.holds, *holds), defaults={**scope.defaults, **own})
        return self._add(inner, values, scope)

    def _extend(self, owner: dict[str, object], path: Address, items: Sequence[Item]) -> None:
        """Adds items to the list at a path, each with the place where it is written."""
        own = owner.get(str(path[-1])) or []
        if items and isinstance(own, list | tuple):
            owner[str(path[-1])] = [*own, *(item for item, _ in items)]
            self.flat.origins.update({(*path, len(own) + index): place for index, (_, place) in enumerate(items)})


def _iter_parameters(located: Located) -> Iterator[tuple[str, GraphParameter]]:
    """Parameters of a sound form; the others are reported with the form of the whole."""
    for name, item in as_dict(as_dict(located.data).get("parameters")).items():
        with suppress(pydantic.ValidationError):
            yield str(name), GraphParameter.model_validate(item)


def _fill(node: dict[str, object], values: Mapping[str, object]) -> Fields:
    """A node with values for parameters; its own variables and arguments come before those of the graph."""
    outer = {key: value for key, value in values.items() if key not in as_dict(node.get("foreach"))}
    inner = {key: value for key, value in outer.items() if key not in as_dict(node.get("with"))}
    return {key: substitute_value(item, outer if key in {"with", "foreach"} else inner) for key, item in node.items()}


def _lengthen(node: Fields, prefix: str) -> Fields:
    """A node whose edges and references lead to nodes with longer names."""
    outputs = {name for _, text in iter_strings(node) for name in REFERENCE.findall(text) if ".outputs." in name}
    longer: Fields = substitute_value(node, {name: f"${{{prefix}{name}}}" for name in outputs})
    if isinstance(longer.get("after"), list):
        longer["after"] = [
            each | {"node": f"{prefix}{each.get('node')}"} if isinstance(each, dict) else f"{prefix}{each}"
            for each in longer["after"]
        ]
    return longer


def as_dict(value: object) -> Fields:
    """The value where it is a mapping, else an empty one; its form is checked elsewhere."""
    return value if isinstance(value, dict) else {}
