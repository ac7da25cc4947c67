"""Leaves, skills, predicates, faults and settings, from the declarations that the code itself uses.

The same as Markdown are the pages of `docs/reference/`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec

from phyagentos.assembly.project import open_library
from phyagentos.errors import DefinitionError, format_hint, get_known
from phyagentos.operations.schema_fields import iter_structures, list_fields
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.skill_runtimes import Parameter, read_skill
from phyagentos.protocol.documents.schema import Authored
from phyagentos.protocol.documents.struct_schema import build_authored_schema
from phyagentos.protocol.predicates.library import PredicateDefinition, get_predicate_library
from phyagentos.protocol.settings.settings_files import SETTINGS_FILES
from phyagentos.protocol.world.faults import FaultFile

_TYPES: dict[type, str] = {float: "number", int: "whole number", str: "text", bool: "true or false", dict: "mapping"}


class Row(msgspec.Struct, frozen=True, omit_defaults=True):
    """One fact, port, parameter, argument or field; `part` says which of these."""

    part: str
    name: str
    takes: str = ""
    default: str = ""
    meaning: str = ""


class Described(msgspec.Struct, frozen=True):
    """A leaf, skill, predicate, fault or setting as it is declared."""

    name: str
    summary: str
    rows: tuple[Row, ...]
    kind: str = ""


def describe_name(name: str) -> tuple[Described, ...]:
    """All that is called so, of any kind; raises DefinitionError `UNKNOWN_NAME`."""
    library, found, known = open_library(), list[Described](), list[str](KINDS)
    for kind, list_all in KINDS.items():
        for each in list_all(library):
            known.append(each.name)
            if each.name == name:
                found.append(msgspec.structs.replace(each, kind=kind))
    if found:
        return tuple(found)
    elsewhere = {
        "paos compile": library.names_of_goal_graphs(),
        "paos scene render": library.names_of_scenes(),
        "paos robot show": library.names_of_targets(),
        "paos tree show": library.names_of_trees(),
    }
    hint = next((f"{command} {name} shows it." for command, names in elsewhere.items() if name in names), "")
    hint = hint or format_hint(name, known) or f"paos list KIND prints the names of {', '.join(KINDS)}."
    raise DefinitionError.of("UNKNOWN_NAME", "paos describe", repr(name), f"a name, or {', '.join(KINDS)}", hint)


def describe(kind: str, name: str = "") -> tuple[Described, ...]:
    """Each leaf, skill, predicate, fault or setting that is called so, or has a row of this name; every one without.

    Raises DefinitionError `UNKNOWN_NAME` for a kind or a name.
    """
    every = list(get_known("kind", "paos describe", kind, KINDS)(open_library()))
    found = [each for each in every if name in {"", each.name, *(row.name for row in each.rows)}]
    if not found:
        raise DefinitionError.unknown(kind, f"paos describe {kind}", name, [each.name for each in every])
    return tuple(msgspec.structs.replace(each, kind=kind) for each in found)


def _iter_leaves(library: Library) -> Iterator[Described]:
    from phyagentos.runtime.execution.leaf_registry import build_registry

    registry = build_registry(library)
    for name in registry.names():
        leaf = registry.get(name)
        ports = [*_iter_ports("input", leaf.INPUT_PORTS), *_iter_ports("output", leaf.OUTPUT_PORTS)]
        yield Described(name, (leaf.__doc__ or "").partition("\n")[0], (Row("role", leaf.ROLE), *ports))


def _iter_ports(part: str, ports: Mapping[str, Any]) -> Iterator[Row]:
    for name, port in ports.items():
        default = str(port.default_value) if port.has_default else "required" if port.required else ""
        yield Row(part, name, _TYPES.get(port.data_type, port.data_type.__name__), default, port.description)


def _describe_skill(path: Path) -> Described:
    skill, _ = read_skill(path)
    conditions = {"requires": skill.requires, "holds": skill.hold, "guarantees": skill.guarantees}
    rows = [Row(part, text) for part, texts in conditions.items() for text in texts]
    rows += [_describe_parameter(name, each) for name, each in skill.parameters.items()]
    rows += [Row("output", name, each.type, "", each.description) for name, each in skill.outputs.items()]
    return Described(skill.skill, skill.description, (Row("tree", skill.tree), *rows))


def _describe_parameter(name: str, each: Parameter) -> Row:
    limits = (("at least", each.minimum), ("at most", each.maximum))
    allowed = [f"{word} {limit:g}" for word, limit in limits if limit is not None]
    allowed += [f"one of {', '.join(names)}" for names in (each.choices, each.kinds) if names]
    default = "" if each.optional else "required" if each.default is None else str(each.default)
    return Row("parameter", name, f"{each.type} {each.unit}".rstrip(), default, "; ".join([each.description, *allowed]))


def _describe_predicate(each: PredicateDefinition) -> Described:
    form = Row("form", each.signature, "a number, to be compared" if each.is_number else "true, false or unknown")
    defaults = {one: "required" if one.default is None else f"{one.default:g}" for one in each.arguments}
    arguments = (Row("argument", one.name, one.kind, default) for one, default in defaults.items())
    return Described(each.name, each.description, (form, *arguments))


def _iter_structures(models: Mapping[str, type[Authored]]) -> Iterator[Described]:
    """The structures of authored files, each under its name in lower case: `slip`, `perception`."""
    for file, model in models.items():
        schema, definitions = build_authored_schema(model)
        for title, each in iter_structures(schema, definitions):
            rows = tuple(Row("field", name, *row) for name, row in list_fields(each, definitions).items())
            about = each.get("description", "").removesuffix(".")
            yield Described(title.lower(), f"The whole of {file}" if about == file else f"{about} ({file})", rows)


KINDS: dict[str, Callable[[Library], Iterable[Described]]] = {
    "leaf": _iter_leaves,
    "skill": lambda library: map(_describe_skill, map(library.get_skill, library.names_of_skills())),
    "predicate": lambda _: map(_describe_predicate, get_predicate_library()),
    "fault": lambda _: _iter_structures({"faults.yaml": FaultFile}),
    "setting": lambda _: _iter_structures(SETTINGS_FILES),
}
