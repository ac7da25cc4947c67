"""JSON Schemas of every authored file and of every document, made from the same models that read them.

Editors use those of authored files through `# yaml-language-server: $schema=…`. The schema of a document describes its
front matter with one more key, `blocks`: heading -> YAML block. `protocol/schemas/` holds them all; a test compares.
The pages of `docs/documents/` have the fields of each as Markdown tables.
"""

import json
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.markdown import render_table
from phyagentos.protocol.documents.schema import Authored, iter_nested

BASE = "https://json-schema.org/draft/2020-12/schema"
_PLAIN = {
    "string": "text",
    "integer": "whole number",
    "number": "number",
    "boolean": "true or false",
    "null": "nothing",
}


def names_of_schemas() -> list[str]:
    """Every kind that has a schema, sorted."""
    return sorted(_builders())


def render_schema(kind: str) -> str:
    """The schema as indented JSON."""
    return json.dumps({"$schema": BASE, **build_schema(kind)}, indent=2, ensure_ascii=False) + "\n"


def build_schema(kind: str) -> dict[str, Any]:
    """The schema as data; raises DefinitionError for an unknown kind."""
    builders = _builders()
    if kind not in builders:
        raise DefinitionError.unknown("UNKNOWN_SCHEMA", "paos schema", kind, builders)
    return builders[kind]()


def _builders() -> dict[str, Callable[[], dict[str, Any]]]:
    from phyagentos.agent.goals.spec import GoalFile
    from phyagentos.bench.suite_file import Suite
    from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime
    from phyagentos.protocol.capabilities.targets import TargetProfile
    from phyagentos.protocol.capabilities.trees import TreeHeader
    from phyagentos.protocol.documents.document import build_schema as build_document_schema
    from phyagentos.protocol.documents.struct_schema import build_authored_schema
    from phyagentos.protocol.settings.settings_files import SETTINGS_FILES
    from phyagentos.protocol.world.faults import FaultFile
    from phyagentos.protocol.world.scenes import SceneSpec
    from phyagentos.store.document_registry import FORMATS

    def build_authored(model: type[Authored]) -> dict[str, Any]:
        schema, definitions = build_authored_schema(model)
        return {"$defs": definitions, **schema} if definitions else schema

    models: dict[str, type[Authored]] = {
        "faults": FaultFile,
        "goal_graph": GoalFile,
        "scene": SceneSpec,
        "skill": SkillRuntime,
        "suite": Suite,
        "target": TargetProfile,
        "tree": TreeHeader,
        **{Path(name).stem: model for name, model in SETTINGS_FILES.items()},
    }
    authored = {kind: partial(build_authored, model) for kind, model in models.items()}
    documents = {each.name: partial(build_document_schema, each) for each in FORMATS.values()}
    return {**authored, **documents}


def render_fields(kind: str) -> str:
    """One table for each structure of a kind, the outermost first; raises DefinitionError for an unknown kind."""
    schema = build_schema(kind)
    definitions = schema.get("$defs", {})
    tables = []
    for title, structure in iter_structures(schema, definitions):
        rows = ((f"`{name}`", *row) for name, row in list_fields(structure, definitions).items())
        tables.append(f"**{title}**\n\n{render_table(('field', 'is', 'default', 'meaning'), rows)}")
    return "\n".join(tables)


def list_fields(structure: dict[str, Any], definitions: dict[str, Any]) -> dict[str, tuple[str, str, str]]:
    """The fields of one structure: name -> what it is, default, meaning."""
    needed = structure.get("required", ())
    return {
        name: (_describe_type(each, definitions), _describe_default(each, is_needed=name in needed), _describe(each))
        for name, each in structure["properties"].items()
    }


def iter_structures(schema: dict[str, Any], definitions: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """The schema itself and every structure that it refers to, in the order of mention."""
    yield schema.get("title", ""), schema
    seen: dict[str, dict[str, Any]] = {}
    waiting = [schema]
    for current in waiting:
        for each in iter_nested(current.get("properties", current)):
            if isinstance(each, dict) and isinstance(each.get("$ref"), str):
                name = each["$ref"].rsplit("/", 1)[-1]
                if name not in seen:
                    seen[name] = definitions[name]
                    waiting.append(definitions[name])
    yield from ((name, each) for name, each in seen.items() if "properties" in each)


def _describe_type(schema: dict[str, Any], definitions: dict[str, Any]) -> str:
    if "$ref" in schema:
        name = schema["$ref"].rsplit("/", 1)[-1]
        named = definitions[name]
        return _list_values(named["enum"]) if "enum" in named else name
    if "allOf" in schema:
        return _describe_type(schema["allOf"][0], definitions)
    if "anyOf" in schema:
        return " or ".join(_describe_type(each, definitions) for each in schema["anyOf"])
    if "const" in schema:
        return _list_values([schema["const"]])
    if "enum" in schema:
        return _list_values(schema["enum"])
    if schema.get("type") == "array":
        if "prefixItems" in schema:
            return f"{len(schema['prefixItems'])} of: {_describe_type(schema['prefixItems'][0], definitions)}"
        return f"list of: {_describe_type(schema.get('items') or {}, definitions)}"
    if schema.get("type") == "object":
        inner: Any = schema.get("additionalProperties") or next(iter(schema.get("properties", {}).values()), {})
        return f"mapping to: {_describe_type(inner, definitions)}" if isinstance(inner, dict) else "mapping"
    return _PLAIN.get(schema.get("type", ""), "anything")


def _list_values(values: list[Any]) -> str:
    return ", ".join(f"`{value}`" for value in values)


def _describe_default(schema: dict[str, Any], *, is_needed: bool) -> str:
    if is_needed:
        return "required"
    default = schema.get("default")
    return "" if default in (None, "", [], (), {}) or isinstance(default, dict) else f"`{default}`"


def _describe(schema: dict[str, Any]) -> str:
    bounds = [
        f"{word} {schema[key]}"
        for key, word in (("minimum", "at least"), ("maximum", "at most"), ("exclusiveMinimum", "above"))
        if key in schema
    ]
    text = schema.get("description", "")
    text = text if text.endswith("...") else text.removesuffix(".")
    return "; ".join(part for part in (text, *bounds) if part)
