"""The body of a journal record: one fenced block of YAML that any YAML reader parses.

Each key stands on one line with its value, which is a plain word or JSON: so it is written and read many times faster
than with libyaml, to which any other YAML is left, that of earlier versions included.
"""

import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import msgspec

from phyagentos.protocol.documents.plain_data import Fields

_OPENING = "\n```yaml\n"
_CLOSING = "```\n"
_WORD = r"[A-Za-z_][A-Za-z0-9_./()-]*(?: [A-Za-z0-9_./()-]+)*"
_PLAIN = re.compile(_WORD)
_LINE = re.compile(rf"({_WORD}): (.+)")
_RESERVED = frozenset({"true", "false", "null", "yes", "no", "on", "off", "y", "n"})
_BREAKS_YAML = re.compile("[\x7f-\x9f\u2028\u2029\ufeff\ufffe\uffff]")  # JSON lets these stand, YAML does not
_NUMBERS = re.compile(rb"[\[\]0-9.,-]*")  # lists of those that JSON, YAML and `repr` write alike
_CONSTANTS = {"true": True, "false": False, "null": None}
_JSON_BEGINS = frozenset('"[{-0123456789')
_ENCODE, _DECODE = msgspec.json.Encoder().encode, msgspec.json.Decoder().decode
_REMEMBERED = 4096  # words come back again and again in a journal


def render_yaml(value: Any) -> str:
    """Block-style YAML of a mapping or list; lists of numbers and words stay on one line; structs become mappings."""
    return _render_value(msgspec.to_builtins(value, str_keys=True), "")[1:] + "\n"


def render_flow(value: Any) -> str:
    """One line of flow-style YAML; structs become mappings."""
    return _render_flow(msgspec.to_builtins(value, str_keys=True))


def prepare_body(body: Mapping[str, Any] | None) -> tuple[Fields | None, str]:
    """The body as any reader gets it (mappings with text as keys, lists, scalars), and as `render_body` writes it."""
    if not body:
        return None, ""
    data = _ENCODE(body)
    # JSON has no infinity
    plain = _to_lists(msgspec.to_builtins(body, str_keys=True)) if b"null" in data else _DECODE(data)
    return plain, _render_lines(plain)


def render_body(body: Mapping[str, Any] | None) -> str:
    """The Markdown that follows the first line of a record; empty without a body."""
    return _render_lines(msgspec.to_builtins(body, str_keys=True)) if body else ""


def parse_body(markdown: str) -> Fields | None:
    """The content of the fenced block of a record; None without one; raises ValueError when it is not YAML."""
    begin = markdown.find(_OPENING)
    end = markdown.rfind("\n" + _CLOSING)
    if begin < 0 or end < begin:
        return None
    text = markdown[begin + len(_OPENING) : end + 1]
    try:
        return _parse_lines(text)
    except (_OtherYaml, msgspec.DecodeError):
        import yaml  # for other writers; it takes 9 ms

        from phyagentos.protocol.documents.yaml_bounds import load_bounded

        try:
            value = load_bounded(text)
        except yaml.YAMLError as error:
            raise ValueError(" ".join(str(error).split())) from error
        return value if isinstance(value, dict) else None


def _render_lines(body: Mapping[str, Any]) -> str:
    lines = [f"{_render_word(key)}: {_render_scalar(value)}\n" for key, value in body.items()]
    return f"{_OPENING}{''.join(lines)}{_CLOSING}"


def _to_lists(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _to_lists(each) for key, each in value.items()}
    return [_to_lists(each) for each in value] if isinstance(value, list | tuple) else value


def _render_value(value: Any, margin: str) -> str:
    """What follows a colon or a dash: lines below it, each with a line feed in front, or a scalar behind a space."""
    kind = type(value)
    if kind is dict and value:
        return "".join(
            [f"\n{margin}{_render_word(k)}:{_render_value(each, margin + '  ')}" for k, each in value.items()]
        )
    if (kind is list or kind is tuple) and any(type(each) is dict and each for each in value):
        return "".join([f"\n{margin}-{_render_item(each, margin + '  ')}" for each in value])
    return " " + _render_scalar(value)


def _render_item(value: Any, margin: str) -> str:
    """An item of a list that holds mappings: a mapping begins behind the dash, a list stands on one line."""
    if type(value) is dict and value:
        return " " + _render_value(value, margin)[len(margin) + 1 :]
    return " " + _render_scalar(value)


def _render_scalar(value: Any) -> str:
    """On one line: a word, or JSON."""
    return _render_word(value) if type(value) is str else _render_flow(value)


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
    """The text is not as `render_body` writes it."""


def _parse_lines(text: str) -> dict[str, object]:
    found: dict[str, object] = {}
    for line in filter(None, text.split("\n")):
        match = _LINE.fullmatch(line)
        if match is None or match[1].lower() in _RESERVED or match[1] in found:
            raise _OtherYaml
        found[match[1]] = _read_value(match[2])
    return found


def _read_value(text: str) -> object:
    if text[0] in _JSON_BEGINS:
        return _DECODE(text)
    if text in _CONSTANTS:
        return _CONSTANTS[text]
    if text.lower() in _RESERVED or _PLAIN.fullmatch(text) is None:
        raise _OtherYaml
    return text
