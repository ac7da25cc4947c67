"""The body of a journal record: one fenced block of YAML that any YAML reader parses.

The writer keeps to a small subset of YAML (block mappings and lists, flow style only as JSON, words plain, other texts
quoted as JSON), which is written and read many times faster than with libyaml; any other YAML is left to libyaml.
"""

import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import msgspec

_OPENING = "\n```yaml\n"
_CLOSING = "```\n"
_WORD = r"[A-Za-z_][A-Za-z0-9_./()-]*(?: [A-Za-z0-9_./()-]+)*"
_PLAIN = re.compile(_WORD)
_LINE = re.compile(rf"( *)(- )?(?:({_WORD}):(?: (.*))?$)?(.*)", re.DOTALL)
_RESERVED = frozenset({"true", "false", "null", "yes", "no", "on", "off", "y", "n"})
_BREAKS_YAML = re.compile("[\x7f-\x9f\u2028\u2029\ufeff\ufffe\uffff]")  # JSON lets these stand, YAML does not
_NUMBERS = re.compile(rb"[\[\]0-9.,-]*")  # lists of those that JSON, YAML and `repr` write alike
_CONSTANTS = {"true": True, "false": False, "null": None}
_JSON_BEGINS = frozenset('"[{-0123456789')
_ENCODE, _DECODE = msgspec.json.Encoder().encode, msgspec.json.Decoder().decode
_INDENT = 2
_REMEMBERED = 4096  # words and lines come back again and again in a journal


def render_yaml(value: Any) -> str:
    """Block-style YAML of a mapping or list; lists of numbers and words stay on one line; structs become mappings."""
    return _render_plain(msgspec.to_builtins(value, str_keys=True))


def render_flow(value: Any) -> str:
    """One line of flow-style YAML; structs become mappings."""
    return _render_flow(msgspec.to_builtins(value, str_keys=True))


def prepare_body(body: Mapping[str, Any] | None) -> tuple[dict[str, Any] | None, str]:
    """The body as any reader gets it (mappings with text as keys, lists, scalars), and as `render_body` writes it."""
    if not body:
        return None, ""
    data = _ENCODE(body)
    # JSON has no infinity
    plain = _to_lists(msgspec.to_builtins(body, str_keys=True)) if b"null" in data else _DECODE(data)
    return plain, _fence(_render_plain(plain))


def render_body(body: Mapping[str, Any] | None) -> str:
    """The Markdown that follows the first line of a record; empty without a body."""
    return _fence(render_yaml(dict(body))) if body else ""


def parse_body(markdown: str) -> dict[str, Any] | None:
    """The content of the fenced block of a record; None without one; raises YAMLError when it is not YAML."""
    begin = markdown.find(_OPENING)
    end = markdown.rfind("\n" + _CLOSING)
    if begin < 0 or end < begin:
        return None
    text = markdown[begin + len(_OPENING) : end + 1]
    try:
        value = _parse_block(text)
    except (_OtherYaml, msgspec.DecodeError):
        from phyagentos.protocol.documents.yaml_bounds import load_bounded  # for other writers; its import takes 9 ms

        value = load_bounded(text)
    return value if isinstance(value, dict) else None


def _fence(yaml: str) -> str:
    return f"{_OPENING}{yaml}{_CLOSING}"


def _to_lists(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _to_lists(each) for key, each in value.items()}
    return [_to_lists(each) for each in value] if isinstance(value, list | tuple) else value


def _render_plain(plain: Any) -> str:
    rendered = _render_value(plain, "")
    return rendered[1:] + "\n"


def _render_value(value: Any, margin: str) -> str:
    """What follows a colon or a dash: lines below it, each with a line feed in front, or a scalar behind a space."""
    kind = type(value)
    if kind is str:
        return " " + _render_word(value)
    if kind is dict and value:
        return "".join(
            [f"\n{margin}{_render_word(k)}:{_render_value(each, margin + '  ')}" for k, each in value.items()]
        )
    if (kind is list or kind is tuple) and any(type(each) is dict and each for each in value):
        return "".join([f"\n{margin}-{_render_item(each, margin + '  ')}" for each in value])
    return " " + _render_flow(value)


def _render_item(value: Any, margin: str) -> str:
    """An item of a list that holds mappings: a mapping begins behind the dash, a list stands on one line."""
    if type(value) is dict and value:
        return " " + _render_value(value, margin)[len(margin) + 1 :]
    return " " + (_render_word(value) if type(value) is str else _render_flow(value))


@lru_cache(maxsize=_REMEMBERED)
def _render_word(text: str) -> str:
    is_plain = _PLAIN.fullmatch(text) is not None and text.lower() not in _RESERVED
    return text if is_plain else _quote(text)


def _quote(text: str) -> str:
    rendered = _ENCODE(text).decode()
    if not text.isascii() or "\x7f" in text:
        rendered = _BREAKS_YAML.sub(lambda match: f"\\u{ord(match[0]):04x}", rendered)
    return rendered


def _render_flow(value: Any) -> str:
    """JSON, which is YAML, with numbers as YAML 1.1 reads them."""
    kind = type(value)
    if kind is str:
        return _quote(value)
    if kind is float:
        return _render_float(value)
    if kind is dict:
        return "{" + ", ".join([f"{_render_flow(key)}: {_render_flow(each)}" for key, each in value.items()]) + "}"
    if kind is list or kind is tuple:
        if value and type(value[0]) is float:
            data = msgspec.json.encode(value)
            if _NUMBERS.fullmatch(data):
                return data.decode().replace(",", ", ")
        return "[" + ", ".join([_render_flow(each) for each in value]) + "]"
    if kind is int:
        return str(value)
    return msgspec.json.encode(value).decode()


def _render_float(value: float) -> str:
    text = repr(value)
    if text[-1] in "fn":  # inf, -inf, nan
        return text.replace("inf", ".inf").replace("nan", ".nan")
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


class _OtherYaml(Exception):
    """The text is outside the subset."""


class _Line(NamedTuple):
    """One line of the subset: a value, JSON that is parsed anew each time (`text`), or the parent of lines below."""

    indent: int
    is_item: bool
    key: str | None
    text: str | None = None
    value: Any = None
    is_parent: bool = False


def _parse_block(text: str) -> Any:
    lines = [_read_line(line) for line in text.split("\n") if line]
    if not lines or lines[0].indent:
        raise _OtherYaml
    value, at = _parse_lines(lines, 0, 0)
    if at < len(lines):
        raise _OtherYaml
    return value


@lru_cache(maxsize=_REMEMBERED)
def _read_line(line: str) -> _Line:
    match = _LINE.fullmatch(line)
    if match is None:
        raise _OtherYaml
    margin, dash, key, value, other = match.groups()
    if key is None and dash:
        return _Line(len(margin), True, None, *_read_value(other))
    if key is None or other or key.lower() in _RESERVED:
        raise _OtherYaml
    return _Line(len(margin), bool(dash), key, *_read_value(value))


def _read_value(text: str | None) -> tuple[str | None, Any, bool]:
    """`text`, `value` and `is_parent` of a line."""
    if text is None:
        return None, None, True
    if text and text[0] in _JSON_BEGINS:
        value = msgspec.json.decode(text)
        return (text, None, False) if isinstance(value, dict | list) else (None, value, False)
    if text in _CONSTANTS:
        return None, _CONSTANTS[text], False
    if text.lower() in _RESERVED or _PLAIN.fullmatch(text) is None:
        raise _OtherYaml
    return None, text, False


def _parse_lines(lines: list[_Line], at: int, indent: int) -> tuple[Any, int]:
    """The mapping or list that begins at line `at`, and the line behind it."""
    if at == len(lines) or lines[at].indent != indent:
        raise _OtherYaml
    return _parse_list(lines, at, indent) if lines[at].is_item else _parse_map(lines, at, indent)


def _parse_map(lines: list[_Line], at: int, indent: int, *, behind_dash: bool = False) -> tuple[dict[str, Any], int]:
    found: dict[str, Any] = {}
    end = len(lines)
    while at < end:
        begin, is_item, key, text, value, is_parent = lines[at]
        if behind_dash:
            begin, is_item, behind_dash = indent, False, False
        if begin != indent:
            break
        if is_item or key is None or key in found:
            raise _OtherYaml
        at += 1
        if is_parent:
            value, at = _parse_lines(lines, at, indent + _INDENT)
        elif text is not None:
            value = msgspec.json.decode(text)
        found[key] = value
    return found, at


def _parse_list(lines: list[_Line], at: int, indent: int) -> tuple[list[Any], int]:
    found: list[Any] = []
    while at < len(lines) and lines[at].indent == indent:
        _, is_item, key, text, value, _ = lines[at]
        if not is_item:
            raise _OtherYaml
        if key is not None:  # a mapping begins behind the dash
            value, at = _parse_map(lines, at, indent + _INDENT, behind_dash=True)
        else:
            at += 1
            if text is not None:
                value = msgspec.json.decode(text)
        found.append(value)
    return found, at
