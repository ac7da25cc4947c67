"""Values of every document at random, and what checks a text against its JSON Schema."""

import json
from enum import EnumType
from functools import cache
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

import jsonschema
import msgspec
import yaml
from hypothesis import strategies as st

from phyagentos.cli.schemas import render_schema
from phyagentos.protocol.documents.document import iter_blocks, split_front_matter
from phyagentos.protocol.documents.log import LOG, read_log
from phyagentos.protocol.documents.schema import parse_yaml
from phyagentos.store.document_registry import FORMATS

NAMES = st.from_regex(r"[a-z][a-z0-9_]{0,8}(\.[a-z0-9]{1,3})?", fullmatch=True)
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=20) | st.sampled_from(
    ["", "a\n## b\n\n```yaml\nx: 1\n```\n", "| cell | `code` |", "---\nview: 9\n---\n", "yes", "1e5", "- a: b # c"]
)
NUMBERS = st.floats(-1e6, 1e6) | st.integers(-1000, 1000).map(float)
WHOLE = st.integers(0, 10**6)
PLAIN = st.recursive(
    st.none() | st.booleans() | WHOLE | NUMBERS | TEXTS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(NAMES, inner, max_size=3),
    max_leaves=4,
)
LEAVES = {str: TEXTS, int: WHOLE, float: NUMBERS, bool: st.booleans(), Any: PLAIN}


@cache
def draw(kind: Any) -> st.SearchStrategy[Any]:
    """Values of a type, structs field by field."""
    kind = getattr(kind, "__supertype__", kind)
    origin, args = get_origin(kind), get_args(kind)
    if kind in LEAVES:
        return LEAVES[kind]
    if isinstance(kind, EnumType):
        return st.sampled_from(list(kind))
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return draw_struct(kind)
    if origin is Literal:
        return st.sampled_from(args)
    if origin is dict:
        return st.dictionaries(NAMES, draw(args[1]), max_size=3)
    if origin is tuple and args[-1] is Ellipsis:
        return st.lists(draw(args[0]), max_size=3).map(tuple)
    if origin is tuple:
        return st.tuples(*map(draw, args))
    if origin in {Union, UnionType}:
        return st.one_of(st.none() if arm is NoneType else draw(arm) for arm in args if arm is not msgspec.UnsetType)
    if args:  # Annotated, with bounds that 0 and 1 keep
        return draw(args[0]).map(lambda value: type(value)(min(abs(value), 1)))
    raise TypeError(kind)


def draw_struct(kind: type[msgspec.Struct], **fields: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    """Structs whose named fields come from elsewhere."""
    types = {field.name: field.type for field in msgspec.structs.fields(kind)}
    return st.fixed_dictionaries(
        {name: fields[name] if name in fields else draw(each) for name, each in types.items()}
    ).map(lambda values: kind(**values))


@cache
def load_schema(name: str) -> dict[str, Any]:
    return json.loads(render_schema(name))


def check_schema(text: str, file: str) -> None:
    jsonschema.validate(extract(text, file), load_schema(FORMATS[file].name))


def extract(text: str, file: str) -> dict[str, Any]:
    """A document as plain data, unchecked: what its JSON Schema describes."""
    front, _ = split_front_matter(text, file)
    blocks = {each.name: parse_yaml(each.yaml, file, each.line).data for each in iter_blocks(text)}
    lines = {"lines": msgspec.to_builtins(list(read_log(text).lines))} if file == LOG.file else {}
    return {**yaml.safe_load(front), "blocks": blocks, **lines}
