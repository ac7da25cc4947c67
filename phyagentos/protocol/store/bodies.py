"""The body of a journal record: one fenced block of YAML that a person reads and any YAML reader parses.

Upstream: whoever commits. Downstream: the fold, and readers in other languages. The writer keeps to a small subset of
YAML (block mappings and lists, flow style only as JSON, words plain, other texts quoted as JSON), so that its own
blocks are written and read some ten times faster than with libyaml; any other YAML is left to libyaml.
"""

import re
from collections.abc import Mapping
from typing import Any

import msgspec
import yaml

_Loader: type[yaml.SafeLoader] = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_OPENING = "\n```yaml\n"
_CLOSING = "```\n"
_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_./()-]*(?: [A-Za-z0-9_./()-]+)*")
_RESERVED = frozenset({"true", "false", "null", "yes", "no", "on", "off", "y", "n"})
_BREAKS_YAML = re.compile("[\x7f-\x9f\u2028\u2029\ufeff\ufffe\uffff]")  # JSON lets these stand, YAML does not
_CONSTANTS = {"true": True, "false": False, "null": None}
_INDENT = 2


def render_yaml(value: Any) -> str:
    """Block-style YAML of a mapping or list; lists of numbers and words stay on one line; structs become mappings."""
    plain = msgspec.to_builtins(value, str_keys=True)
    lines: list[str] = []
    if not plain or not isinstance(plain, dict | list | tuple):
        lines.append(_render_flow(plain))
    else:
        _render_block(plain, 0, lines)
    return "\n".join(lines) + "\n"


def render_body(body: Mapping[str, Any] | None) -> str:
    """The Markdown that follows the first line of a record; empty without a body."""
    return f"{_OPENING}{render_yaml(dict(body))}{_CLOSING}" if body else ""


def parse_body(markdown: str) -> dict[str, Any] | None:
    """What stands in the fenced block of a record; None when there is none.

    Raises:
        yaml.YAMLError: When the block is not YAML.
    """
    begin = markdown.find(_OPENING)
    end = markdown.rfind("\n" + _CLOSING)
    if begin < 0 or end < begin:
        return None
    text = markdown[begin + len(_OPENING) : end + 1]
    try:
        value = _Block(text).parse()
    except (_OtherYaml, msgspec.DecodeError):
        value = yaml.load(text, Loader=_Loader)
    return value if isinstance(value, dict) else None


def _render_block(value: Any, indent: int, lines: list[str]) -> None:
    margin = " " * indent
    if isinstance(value, dict):
        for key, each in value.items():
            if _is_flow(each):
                lines.append(f"{margin}{_render_scalar(key)}: {_render_value(each)}")
            else:
                lines.append(f"{margin}{_render_scalar(key)}:")
                _render_block(each, indent + _INDENT, lines)
        return
    for each in value:
        if isinstance(each, dict) and each:
            first = len(lines)
            _render_block(each, indent + _INDENT, lines)
            lines[first] = f"{margin}- {lines[first][indent + _INDENT :]}"
        else:
            lines.append(f"{margin}- {_render_value(each)}")


def _is_flow(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return not any(isinstance(each, dict) and each for each in value)
    return not (isinstance(value, dict) and value)


def _render_value(value: Any) -> str:
    return _render_flow(value) if isinstance(value, dict | list | tuple) else _render_scalar(value)


def _render_scalar(value: Any) -> str:
    if isinstance(value, str) and _PLAIN.fullmatch(value) and value.lower() not in _RESERVED:
        return value
    return _render_flow(value)


def _render_flow(value: Any) -> str:
    """JSON, which is YAML, with numbers as YAML 1.1 reads them."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_render_flow(key)}: {_render_flow(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join([_render_flow(each) for each in value]) + "]"
    if isinstance(value, float):
        return _render_float(value)
    text = msgspec.json.encode(value).decode()
    return _BREAKS_YAML.sub(lambda match: f"\\u{ord(match[0]):04x}", text) if isinstance(value, str) else text


def _render_float(value: float) -> str:
    text = repr(value)
    if text[-1] in "fn":  # inf, -inf, nan
        return text.replace("inf", ".inf").replace("nan", ".nan")
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


class _OtherYaml(Exception):
    """The text is outside the subset."""


class _Block:
    """Reads the subset that `render_yaml` writes; refuses everything else."""

    def __init__(self, text: str) -> None:
        self._lines = [(len(line) - len(rest), rest) for line in text.split("\n") if (rest := line.lstrip(" "))]
        self._at = 0

    def parse(self) -> Any:
        value = self._parse(0)
        if self._at < len(self._lines):
            raise _OtherYaml
        return value

    def _parse(self, indent: int) -> Any:
        if self._at == len(self._lines) or self._lines[self._at][0] != indent:
            raise _OtherYaml
        return self._parse_list(indent) if self._lines[self._at][1].startswith("- ") else self._parse_map(indent)

    def _parse_map(self, indent: int) -> dict[str, Any]:
        found: dict[str, Any] = {}
        while self._at < len(self._lines) and self._lines[self._at][0] == indent:
            key, colon, rest = self._lines[self._at][1].partition(":")
            if not colon or key in found or _parse_plain(key) != key:
                raise _OtherYaml
            self._at += 1
            if rest.startswith(" "):
                found[key] = _parse_value(rest[1:])
            elif rest:
                raise _OtherYaml
            else:
                found[key] = self._parse(indent + _INDENT)
        return found

    def _parse_list(self, indent: int) -> list[Any]:
        found = []
        while self._at < len(self._lines) and self._lines[self._at][0] == indent:
            dash, rest = self._lines[self._at][1][:2], self._lines[self._at][1][2:]
            if dash != "- ":
                raise _OtherYaml
            key, colon, _ = rest.partition(":")
            if colon and _PLAIN.fullmatch(key):  # a mapping begins behind the dash
                self._lines[self._at] = (indent + _INDENT, rest)
                found.append(self._parse_map(indent + _INDENT))
            else:
                self._at += 1
                found.append(_parse_value(rest))
        return found


def _parse_value(text: str) -> Any:
    if text and text[0] in '"[{-0123456789':
        return msgspec.json.decode(text)
    return _parse_plain(text)


def _parse_plain(text: str) -> Any:
    if text in _CONSTANTS:
        return _CONSTANTS[text]
    if text.lower() in _RESERVED or _PLAIN.fullmatch(text) is None:
        raise _OtherYaml
    return text
