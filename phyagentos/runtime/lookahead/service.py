"""Asks the forecasters that a session names, and puts their answers into one result, from a process of its own.

It is started at the first question and kept warm: imagined worlds never share a process with the real one, and their
errors stay there.
"""

import math
import signal
from collections.abc import Callable, Sequence
from functools import lru_cache
from multiprocessing.connection import Connection
from typing import Any

from msgspec.structs import asdict, replace

from phyagentos.clock import Clock, SystemClock
from phyagentos.errors import DefinitionError, ExecutionError, list_foreign_errors
from phyagentos.protocol.sessions.calibration import TrackRecord
from phyagentos.protocol.sessions.lookahead import Forecast, LookaheadResult
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.channel import Child
from phyagentos.runtime.codec import Codec
from phyagentos.runtime.lookahead.forecaster import LOOKAHEAD_FAILED, Case, Forecaster, ForecasterSite, open_forecaster
from phyagentos.store.forecast_record import read_forecasting

WAIT_S = 0.1  # longest sleep between looks at a cancellation
CLOSE_GRACE_S = 1.0
_QUESTIONS = Codec[Case](Case, "question")
_ANSWERS = Codec[LookaheadResult | str](LookaheadResult | str, "forecast")  # a text says why there is none


class ForecastService:
    """Answers cases; `open` makes the forecaster of a name, when it is first asked, and raises DefinitionError."""

    def __init__(self, open: Callable[[str], Forecaster], clock: Clock) -> None:
        self._open, self._clock = lru_cache(maxsize=None)(open), clock

    def forecast(self, case: Case) -> LookaheadResult:
        """The forecast of the first that answers, and beside it those of the others.

        One that the request distrusts is not asked. One that fails is passed over, with a note; where all asked ones
        do, the error of the first is raised.
        """
        answers: list[Forecast] = []
        withheld: dict[str, TrackRecord] = {}
        errors: list[DefinitionError | ExecutionError] = []
        for name in dict.fromkeys(case.request.forecasters):
            try:
                forecaster = self._open(name)
                if (record := case.request.distrusted.get(forecaster.name)) is not None:
                    withheld[forecaster.name] = record
                else:
                    answers.append(self._ask(forecaster, case))
            except (DefinitionError, ExecutionError) as error:
                errors.append(error)
        if errors and not answers:
            raise errors[0]
        first = answers[0] if answers else Forecast(samples=0, succeeded=0, forecaster="")
        notes = (*first.notes, *(f"no forecast: {error}" for error in errors))
        decisive = asdict(first) | {"notes": notes, "threshold": case.request.threshold}
        return LookaheadResult(**decisive, others=tuple(answers[1:]), withheld=withheld)

    def _ask(self, forecaster: Forecaster, case: Case) -> Forecast:
        began_s = self._clock.now_s()
        try:
            answer: object = forecaster.forecast(case)
        except (DefinitionError, ExecutionError):
            raise
        except list_foreign_errors() as error:
            raise ExecutionError(LOOKAHEAD_FAILED, f"{forecaster.name}: {type(error).__name__}: {error}") from error
        if not isinstance(answer, Forecast) or not _adds_up(answer):
            raise ExecutionError(LOOKAHEAD_FAILED, f"{forecaster.name} answered with no distribution: {answer!r}")
        return replace(answer, forecaster=forecaster.name, cost_ms=1e3 * (self._clock.now_s() - began_s))


def _adds_up(forecast: Forecast) -> bool:
    """Whether the numbers of cases are none below zero, and are all cases."""
    numbers = (forecast.succeeded, *forecast.causes.values())
    return forecast.samples > 0 and min(numbers) >= 0 and math.isclose(math.fsum(numbers), forecast.samples)


def open_service(workspace: Workspace, target: str) -> ForecastService:
    """What answers for a target, with the settings of its workspace."""
    options = read_forecasting(workspace).options
    return ForecastService(
        lambda name: open_forecaster(name, ForecasterSite(workspace, target, options.get(name, {}))), SystemClock()
    )


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
        if isinstance(answer, str):
            raise ExecutionError(LOOKAHEAD_FAILED, answer)
        return answer

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
            try:
                answer: LookaheadResult | str = service.forecast(asked)
            except (DefinitionError, ExecutionError) as error:
                answer = str(error)
            connection.send_bytes(_ANSWERS.encode(answer))
        except (EOFError, OSError):
            return
