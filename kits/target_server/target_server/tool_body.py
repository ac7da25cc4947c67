"""A body without joints: its tools take time, one step of its world after the other.

A tool is a generator: it yields an action, which is the next step of the world, looks at what has become of it, and
yields again. Between any two steps the session may stop it; without a tool the world goes on with the body at rest.
"""

from abc import abstractmethod
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from target_server.body import Body, Joint
from target_server.procedures import Call, Procedure, Progress
from target_server.wire import Refusal

Action = TypeVar("Action")
Steps = Generator[Action, None, str]
"""What a tool is: an action for each step, and what it says at its end."""
_TYPES: Mapping[str, Callable[[Any], bool]] = {
    "string": lambda value: isinstance(value, str),
    "integer": lambda value: type(value) is int,
    "number": lambda value: type(value) in (int, float),
    "boolean": lambda value: type(value) is bool,
}


class ToolFailed(Exception):
    """A tool cannot do what it was called for; the message says why. Its steps so far stand."""


@dataclass(frozen=True)
class Tool(Generic[Action]):
    """One tool of a body.

    Attributes:
        run: Takes the arguments by name, yields an action for each step and returns what it says at its end; raises
            `ToolFailed`.
        arguments: Type of each: `string`, `integer`, `number` or `boolean`.
        choices: What an argument of text may be, where it is one of few.
        defaults: Values of arguments that may be left out.
    """

    run: Callable[..., Steps[Action]]
    arguments: Mapping[str, str] = field(default_factory=dict)
    choices: Mapping[str, Sequence[str]] = field(default_factory=dict)
    defaults: Mapping[str, Any] = field(default_factory=dict)

    def check(self, name: str, given: Mapping[str, Any]) -> dict[str, Any]:
        """The arguments, complete; raises `Refusal` `REQUEST_INVALID`."""
        values = {**self.defaults, **given}
        if values.keys() != self.arguments.keys():
            raise Refusal("REQUEST_INVALID", f"{name} of {sorted(given)}; it takes {sorted(self.arguments)}")
        for key, value in values.items():
            known = self.choices.get(key)
            if not _TYPES[self.arguments[key]](value) or (known is not None and value not in known):
                expected = f"one of {', '.join(known)}" if known is not None else f"of type {self.arguments[key]}"
                raise Refusal("REQUEST_INVALID", f"{name}: {key} is {value!r}; it is {expected}")
        return values


class ToolCall(Call, Generic[Action]):
    """A tool that was called: it has said its next action, or ended."""

    def __init__(self, steps: Steps[Action]) -> None:
        self._steps, self._n_steps = steps, 0
        self._state, self._message = "running", ""
        self.action: Action | None = None
        self.go_on()

    @property
    def is_at_work(self) -> bool:
        """Whether its action is to be done."""
        return self._state == "running"

    def go_on(self) -> None:
        """Let the tool look at its world, and say what it does next."""
        try:
            self.action = next(self._steps)
            self._n_steps += 1
        except StopIteration as end:
            self._end("succeeded", end.value)
        except ToolFailed as failure:
            self._end("aborted", str(failure))

    def read(self) -> Progress:
        steps = {"steps": self._n_steps}
        return Progress(self._state, steps, steps if self._state == "succeeded" else {}, self._message)

    def cancel(self) -> None:
        if self.is_at_work:
            self._steps.close()
            self._end("cancelled", "between two steps")

    def _end(self, state: str, message: str) -> None:
        self._state, self._message, self.action = state, message, None


class ToolBody(Body, Generic[Action]):
    """A body of tools; one is at work at a time, and the next one that is called cancels it.

    Attributes:
        toolbox: Its tools by name.
    """

    joints: Sequence[Joint] = ()
    observations: Sequence[str] = ("inventory", "entity_poses")
    actions: Sequence[str] = ("tools",)
    toolbox: Mapping[str, Tool[Action]] = {}
    _call: ToolCall[Action] | None = None

    @property
    def procedures(self) -> Sequence[Procedure]:  # type: ignore[override]
        """The tools, as the wire describes them."""
        steps = {"steps": "integer"}
        return tuple(
            Procedure(name, "procedure", "", each.arguments, steps, steps) for name, each in self.toolbox.items()
        )

    @abstractmethod
    def act(self, action: Action | None) -> None:
        """One step of the world, with this action; None to do nothing. `step_s` has passed then."""

    def call(self, procedure: str, goal: Mapping[str, Any]) -> Call:
        tool = self.toolbox[procedure]
        arguments = tool.check(procedure, goal)
        if self._call is not None:
            self._call.cancel()
        self._call = ToolCall(tool.run(**arguments))
        return self._call

    def step(self, q: Sequence[float], qd: Sequence[float], width_m: float) -> str:
        call = self._call if self._call is not None and self._call.is_at_work else None
        self.act(call.action if call is not None else None)
        if call is not None:
            call.go_on()
        return ""

    def stay(self) -> None:
        self.act(None)

    def halt(self, category: int) -> None:
        """The call is cancelled by who serves the body; it rests at once."""
