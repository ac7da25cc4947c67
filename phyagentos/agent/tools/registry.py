"""The tools that an agent outside of this process may use: declared, checked before they run, offered up to a level.

Upstream: an adapter such as the MCP server. Downstream: the functions behind the commands. It knows no wire.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from inspect import signature
from pathlib import Path
from typing import Any, get_type_hints

import msgspec
import pydantic

from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.schema import Authored, Located, validate

ARGUMENTS_MAX = 1 << 18  # bytes of the arguments of one call, as JSON
_SHOWN_MAX = 1 << 12  # bytes of arguments that the record of a call repeats


class Level(StrEnum):
    """How far a client may go; each level includes those before it."""

    READ = "read"
    """Look, check and explain; and stop, which is permitted to everyone."""
    PROPOSE = "propose"
    """Propose goals, which a person approves or denies."""
    SUBMIT = "submit"
    """Propose goals on which a policy of the operator may decide without a person."""


_ORDER = tuple(Level)


class ToolArguments(Authored):
    """Base of the arguments of every tool: no unknown keys, no number out of a text."""

    model_config = pydantic.ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


@dataclass(frozen=True, slots=True)
class Answer:
    """What a tool found: facts as plain data, and pictures to look at."""

    facts: Mapping[str, Any]
    pictures: tuple[Path, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Tool:
    """One declared tool.

    Attributes:
        level: The least level at which it is offered.
        is_stop: Brings robots to rest; offered at every level, and never waits for other calls.
        is_destructive: Ends what cannot be taken up again.
    """

    name: str
    description: str
    level: Level
    arguments: type[ToolArguments]
    handler: Callable[..., Answer]
    is_stop: bool = False
    is_destructive: bool = False

    @classmethod
    def of(cls, handler: Callable[..., Answer], level: Level = Level.READ, **facts: bool) -> "Tool":
        """The tool that is called like a function, described by its docstring, and takes its parameters."""
        name, hints = handler.__name__, get_type_hints(handler, include_extras=True)
        taken = {
            key: (hints[key], ... if each.default is each.empty else each.default)
            for key, each in signature(handler).parameters.items()
        }
        model: type[ToolArguments] = pydantic.create_model(name, __base__=ToolArguments, **taken)  # type: ignore[call-overload]  # fields by name
        about = " ".join((handler.__doc__ or "").split())
        return cls(name=name, description=about, level=level, arguments=model, handler=handler, **facts)

    @property
    def is_read_only(self) -> bool:
        """Whether it changes nothing."""
        return self.level is Level.READ and not self.is_stop


class ToolCall(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The record of one call: `code` is that of the refusal or failure, empty where it was answered."""

    at: str
    tool: str
    arguments: Any = None
    code: str = ""


class ToolRegistry:
    """Tools by name, of which those up to a level can be called; each call is recorded, refused ones included."""

    def __init__(
        self, tools: Iterable[Tool], level: Level, *, clock: Clock, record: Callable[[ToolCall], None]
    ) -> None:
        self._tools = {tool.name: tool for tool in tools}
        self.level, self._clock, self._record = level, clock, record

    def list_offered(self) -> list[Tool]:
        """The tools that can be called, as declared."""
        highest = _ORDER.index(self.level)
        return [each for each in self._tools.values() if each.is_stop or _ORDER.index(each.level) <= highest]

    def _get(self, name: str) -> Tool:
        offered, tool = {each.name: each for each in self.list_offered()}, self._tools.get(name)
        if tool is None:
            raise DefinitionError.unknown("tool", "tools", name, offered)
        if name not in offered:
            hint = f"The operator starts the server with --level {tool.level} to offer it."
            raise DefinitionError.of("NOT_PERMITTED", name, f"level {self.level}", f"level {tool.level}", hint)
        return tool

    def call(self, name: str, arguments: object) -> Answer:
        """Check the arguments, plain data as received, and run the tool; raises DefinitionError with every problem."""
        code, size = "", _measure(arguments)
        try:
            tool = self._get(name)
            if not 0 < size <= ARGUMENTS_MAX:
                found, expected = f"{size} bytes of JSON", f"UTF-8, at most {ARGUMENTS_MAX} bytes"
                raise DefinitionError.of("TOO_LARGE" if size else "INVALID_VALUE", name, found, expected)
            known = tool.arguments.model_fields
            if tool.is_stop and isinstance(arguments, dict):  # what it does not know holds up no stop
                arguments = {key: each for key, each in arguments.items() if key in known}
            given = validate(tool.arguments, Located(arguments, f"arguments of {name}"))
            return tool.handler(**{key: getattr(given, key) for key in known})
        except BaseException as error:
            coded = error.problems[0] if isinstance(error, DefinitionError) else error
            code = str(getattr(coded, "code", type(error).__name__))
            raise
        finally:
            shown = arguments if 0 < size <= _SHOWN_MAX else f"{size} bytes"
            self._record(ToolCall(at=self._clock.wall_iso(), tool=name[:80], arguments=shown, code=code))


def _measure(arguments: object) -> int:
    """Bytes as JSON; 0 where they are none."""
    try:
        return len(msgspec.json.encode(arguments))
    except (TypeError, UnicodeEncodeError, RecursionError, OverflowError):
        return 0
