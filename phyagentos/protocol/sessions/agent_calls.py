"""The files between a session and the outside agent that directs it: `loops/<session>/turn.json`, and one answer each.

An answer is taken once, and a rerun finds the same ones. Paper section 4.1.
"""

import os
from pathlib import Path
from typing import Any

import msgspec

from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.durable_files import create_durably, replace_durably
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.regular_files import DOCUMENT_MAX, REQUEST_MAX, read_regular


class Turn(msgspec.Struct, frozen=True, kw_only=True):
    """What an agent is shown before it decides.

    Attributes:
        turn: Number of the decision that is awaited, from 1.
        calls_left: This one included; refused ones count.
        time_s: The target's time [s].
        tools: Names and JSON Schemas of what can be invoked.
        result: What came of the call before; empty at first.
    """

    turn: int
    objective: str
    accept: tuple[str, ...]
    calls_left: int
    time_s: float
    tools: tuple[Fields, ...]
    result: Fields = {}


class CallFiles:
    """The files of one session."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def show(self, turn: Turn) -> None:
        """Publish a turn as a whole."""
        self._folder.mkdir(parents=True, exist_ok=True)
        replace_durably(self._folder / "turn.json", msgspec.json.encode(turn))

    def find_turn(self) -> Turn | None:
        """The turn that awaits its answer, None without one."""
        try:
            turn = msgspec.json.decode(read_regular(self._folder / "turn.json", DOCUMENT_MAX, follow=False), type=Turn)
        except (OSError, msgspec.DecodeError):
            return None
        return None if os.path.lexists(self._get_answer(turn.turn)) else turn

    def answer(self, turn: int, call: dict[str, object]) -> None:
        """Answer a turn; raises DefinitionError `ALREADY_OVER` unless it is the one that awaits an answer."""
        awaited = self.find_turn()
        is_open = awaited is not None and awaited.turn == turn
        if not is_open or not create_durably(self._get_answer(turn), msgspec.json.encode(call)):
            expected = f"turn {awaited.turn}" if awaited is not None else "no turn awaits an answer now"
            raise DefinitionError.of("ALREADY_OVER", self._folder.name, f"turn {turn}", expected)

    def find_answer(self, turn: int) -> Any:
        """The answer to a turn as plain data, None before there is one; what cannot be read is an empty one."""
        try:
            return msgspec.json.decode(read_regular(self._get_answer(turn), REQUEST_MAX, follow=False))
        except FileNotFoundError:
            return None
        except (OSError, ValueError, RecursionError):
            return {}

    def _get_answer(self, turn: int) -> Path:
        return self._folder / f"answer-{turn:04}.json"
