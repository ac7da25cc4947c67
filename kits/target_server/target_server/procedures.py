"""What a body does by itself when it is called: named procedures with a goal, feedback, a result and a cancel.

A body declares `Procedure`s and starts a `Call` of one. `Calls` holds those of the session under authority: it keeps
what a call ended with, cancels all of them at a stop or at the end of the session, and notes a cancel that its server
does not confirm in time.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from target_server.wire import Refusal

PENDING, RUNNING, CANCELLING = "pending", "running", "cancelling"
ENDED = ("succeeded", "aborted", "rejected", "cancelled", "lost")
CANCEL_MAX_S = 5.0  # the end of a session waits for it


@dataclass(frozen=True)
class Procedure:
    """One procedure. A path leads to a field of a message: `pose.position.x`, and `ways[].speed` in each of a list.

    Of a value it has the number: `ways.0.speed`.

    Attributes:
        name: As trees write it.
        kind: `action`, `service`, `topic`, or `procedure` of a body without ROS.
        type: Of its messages, where they have one.
        goal: Type by path of what it takes: `number`, `integer`, `string`, `boolean`, `pose`, `point`, and `number[]`,
            `integer[]`, `string[]`, `boolean[]`; `feedback` and `result` of what it gives.
    """

    name: str
    kind: str = "procedure"
    type: str = ""
    goal: Mapping[str, str] = field(default_factory=dict)
    feedback: Mapping[str, str] = field(default_factory=dict)
    result: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Progress:
    """How far a call is.

    Attributes:
        state: `pending` until it is accepted, `running`, `cancelling`, or one of `ENDED`: `rejected` and `aborted` by
            its server, `lost` where there is no server.
        feedback: The latest values by path; a pose is a map of `position_m` and `quaternion_wxyz`.
        result: As `feedback`, at the end.
        message: One sentence about the state.
    """

    state: str
    feedback: Mapping[str, Any] = field(default_factory=dict)
    result: Mapping[str, Any] = field(default_factory=dict)
    message: str = ""

    def encode(self) -> dict[str, Any]:
        """The reply of the wire."""
        return {"type": "Progress", **vars(self)}


class Call(ABC):
    """A procedure that was called."""

    @abstractmethod
    def read(self) -> Progress:
        """The present; never waits."""

    @abstractmethod
    def cancel(self) -> None:
        """Ask for its end; also before it is accepted. Never waits."""


@dataclass
class _Running:
    procedure: str
    call: Call
    cancel_within_s: float
    cancelled_s: float | None = None


class Calls:
    """The calls of one body: those of the present session by their numbers, and what earlier ones have left behind."""

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        self._running: dict[int, _Running] = {}
        self._ended: dict[int, Progress] = {}
        self._left: list[_Running] = []

    @property
    def is_running(self) -> bool:
        """Whether a call of the session has not ended, as far as was read."""
        return bool(self._running)

    @property
    def longest_s(self) -> float:
        """The longest time that a call which runs may take to confirm a cancel [s]."""
        return max((each.cancel_within_s for each in self._running.values()), default=0.0)

    def begin(self) -> None:
        """A session begins; raises `Refusal` `BUSY` while a call of an earlier one runs on."""
        self._left = [each for each in self._left if each.call.read().state not in ENDED]
        for each in self._left:
            message = f"{each.procedure} of an earlier session runs on: its server has not confirmed the cancel"
            raise Refusal("BUSY", message)
        self._running.clear()
        self._ended.clear()

    def start(self, number: int, name: str, cancel_within_s: float, start: Callable[[], Call]) -> Progress:
        """Call a procedure; one call of each runs at a time, and no number is given twice.

        Raises:
            Refusal: `BUSY`, `MALFORMED`, and what `start` raises.
        """
        if number in self._running or number in self._ended or not 0.0 <= cancel_within_s <= CANCEL_MAX_S:
            raise Refusal("MALFORMED", f"call {number} again, or a cancel within {cancel_within_s} s of {CANCEL_MAX_S}")
        for other, each in [*self._running.items()]:
            if each.procedure == name and self.read(other).state not in ENDED:
                raise Refusal("BUSY", f"{name} runs already")
        self._running[number] = _Running(name, start(), cancel_within_s)
        return self.read(number)

    def read(self, number: int) -> Progress:
        """The present of a call; what it ended with stays."""
        if number in self._ended:
            return self._ended[number]
        if number not in self._running:
            raise Refusal("REQUEST_INVALID", f"no call {number}")
        running = self._running[number]
        progress = running.call.read()
        if progress.state in ENDED:
            self._ended[number] = progress
            del self._running[number]
        elif running.cancelled_s is not None:
            message = f"the cancel was not confirmed within {running.cancel_within_s:g} s"
            state, message = ("lost", message) if self._is_overdue(running) else (CANCELLING, progress.message)
            progress = Progress(state, progress.feedback, message=message)
        return progress

    def cancel(self, number: int) -> Progress:
        """Ask for the end of a call; again, and after its end, it changes nothing."""
        running = self._running.get(number)
        if running is not None and running.cancelled_s is None:
            running.cancelled_s = self._now_s()
            running.call.cancel()
        return self.read(number)

    def cancel_all(self) -> None:
        """Ask for the end of every call."""
        for number in [*self._running]:
            self.cancel(number)

    def has_ended(self) -> bool:
        """Whether every call has ended."""
        return all(self.read(number).state in ENDED for number in [*self._running])

    def leave(self) -> None:
        """The session ends; what has not ended stays known."""
        self._left += self._running.values()
        self._running.clear()

    def check(self) -> None:
        """Refuse what moves while a cancel is overdue: the robot does what no session wants."""
        for number, running in [*self._running.items()]:
            self.read(number)
            if number in self._running and self._is_overdue(running):
                message = f"{running.procedure} runs on: its cancel was not confirmed in {running.cancel_within_s:g} s"
                raise Refusal("PROTECTIVE_STOP", message)

    def _is_overdue(self, running: _Running) -> bool:
        return running.cancelled_s is not None and self._now_s() > running.cancelled_s + running.cancel_within_s
