"""Asks the forecasters that a session names, and puts their answers into one result."""

import math
from collections.abc import Callable
from functools import lru_cache

from msgspec.structs import asdict, replace

from phyagentos.clock import Clock, SystemClock
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.sessions.calibration import TrackRecord
from phyagentos.protocol.sessions.lookahead import Forecast, LookaheadResult
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.lookahead.forecaster import LOOKAHEAD_FAILED, Case, Forecaster, ForecasterSite, open_forecaster
from phyagentos.store.forecast_record import read_forecasting


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
        except Exception as error:  # foreign code
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
