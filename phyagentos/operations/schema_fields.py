"""The structures of a JSON Schema and their fields, in words."""

from collections.abc import Iterator
from typing import Any

from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import iter_nested

_PLAIN = {
    "string": "text",
    "integer": "whole number",
    "number": "number",
    "boolean": "true or false",
    "null": "nothing",
}


def list_fields(structure: Fields, definitions: Fields) -> dict[str, tuple[str, str, str]]:
    """The fields of one structure: name -> what it is, default, meaning."""
    needed = structure.get("required", ())
    return {
        name: (_describe_type(each, definitions), _describe_default(each, is_needed=name in needed), _describe(each))
        for name, each in structure["properties"].items()
    }


def iter_structures(schema: Fields, definitions: Fields) -> Iterator[tuple[str, Fields]]:
    """The schema itself and every structure that it refers to, in the order of mention."""
    yield schema.get("title", ""), schema
    seen: dict[str, Fields] = {}
    waiting = [schema]
    for current in waiting:
        for each in iter_nested(current.get("properties", current)):
            if isinstance(each, dict) and isinstance(each.get("$ref"), str):
                name = each["$ref"].rsplit("/", 1)[-1]
                if name not in seen:
                    seen[name] = definitions[name]
                    waiting.append(definitions[name])
    yield from ((name, each) for name, each in seen.items() if "properties" in each)


def _describe_type(schema: Fields, definitions: Fields) -> str:
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


def _describe_default(schema: Fields, *, is_needed: bool) -> str:
    if is_needed:
        return "required"
    default = schema.get("default")
    return "" if default in (None, "", [], (), {}) or isinstance(default, dict) else f"`{default}`"


def _describe(schema: Fields) -> str:
    bounds = [
        f"{word} {schema[key]}"
        for key, word in (("minimum", "at least"), ("maximum", "at most"), ("exclusiveMinimum", "above"))
        if key in schema
    ]
    text = schema.get("description", "")
    text = text if text.endswith("...") else text.removesuffix(".")
    return "; ".join(part for part in (text, *bounds) if part)
