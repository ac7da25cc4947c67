"""The process of the forecasters, and the port through which a worker asks it.

It is started at the first question and kept warm: imagined worlds never share a process with the real one, and their
errors stay there.
"""

import signal
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from typing import Any

import msgspec

from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.sessions.lookahead import LookaheadResult
from phyagentos.runtime.channel import Child
from phyagentos.runtime.codec import Codec
from phyagentos.runtime.lookahead.forecaster import LOOKAHEAD_FAILED, Case
from phyagentos.runtime.lookahead.service import ForecastService

WAIT_S = 0.1  # longest sleep between looks at a cancellation
CLOSE_GRACE_S = 1.0


class Foreseen(msgspec.Struct, frozen=True, tag=True):
    """The answer."""

    result: LookaheadResult


class Unforeseen(msgspec.Struct, frozen=True, tag=True):
    """Why there is no answer."""

    message: str


_QUESTIONS = Codec[Case](Case, "question")
_ANSWERS = Codec[Foreseen | Unforeseen](Foreseen | Unforeseen, "forecast")


class RehearsalProcess:
    """Answers from a process of its own, started by `command` and `--descriptor N`, its end of the connection."""

    def __init__(self, command: Sequence[str]) -> None:
        self._command = command
        self._child: Child | None = None

    def ask(self, question: Case, should_stop: Callable[[], bool]) -> LookaheadResult | None:
        """The forecast; None once `should_stop` is true, which is called several times a second.

        Raises ExecutionError `LOOKAHEAD_FAILED`.
        """
        child = self._child = self._child or Child(self._command)
        try:
            child.channel.send_bytes(_QUESTIONS.encode(question))
            while not child.channel.poll(WAIT_S):
                if should_stop():
                    child.kill()
                    self._child = None  # another one is started when it is asked again
                    return None
            answer = _ANSWERS.decode(child.channel.recv_bytes())
        except (EOFError, OSError) as error:
            code, self._child = child.kill(), None
            raise ExecutionError(LOOKAHEAD_FAILED, f"the rehearsal process ended with code {code}") from error
        if isinstance(answer, Unforeseen):
            raise ExecutionError(LOOKAHEAD_FAILED, answer.message)
        return answer.result

    def close(self) -> None:
        """End the process."""
        if self._child is not None:
            self._child.close(CLOSE_GRACE_S)


def serve(service: ForecastService, connection: "Connection[Any, Any]") -> None:
    """Answer until the connection ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the worker ends it
    while True:
        try:
            asked = _QUESTIONS.decode(connection.recv_bytes())
            connection.send_bytes(_ANSWERS.encode(_answer(service, asked)))
        except (EOFError, OSError):
            return


def _answer(service: ForecastService, asked: Case) -> Foreseen | Unforeseen:
    try:
        return Foreseen(service.forecast(asked))
    except (DefinitionError, ExecutionError) as error:
        return Unforeseen(str(error))
