"""The port of forecasters (world models): a session from an estimate on gives a distribution over its outcomes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import msgspec

from phyagentos.errors import DefinitionError, PhyAgentOSError, list_foreign_errors
from phyagentos.protocol.sessions.forecasters import find_forecaster
from phyagentos.protocol.sessions.lookahead import Forecast, LookaheadRequest
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import Environment

LOOKAHEAD_FAILED = "LOOKAHEAD_FAILED"


class Case(msgspec.Struct, frozen=True, tag=True):
    """One question: a contract, carried out by a tree (empty for a policy), from the estimate of the world on."""

    session: Session
    request: LookaheadRequest
    tree: str
    environment: Environment


class Forecaster(Protocol):
    """Foresees sessions of one target."""

    @property
    def name(self) -> str:
        """Name, version and configuration (`learned/1(9f86d081)`): what its forecasts are scored under."""

    def forecast(self, case: Case) -> Forecast:
        """What the session is likely to end in; the same for the same case.

        Raises ExecutionError `LOOKAHEAD_FAILED`, or another code, where it cannot say.
        """


@dataclass(frozen=True, slots=True)
class ForecasterSite:
    """What a forecaster is made for; `options` are those of `forecasting.options` in runtime_contract.yaml."""

    workspace: Workspace
    target: str
    options: Mapping[str, str | float | bool] = field(default_factory=dict)


def open_forecaster(name: str, site: ForecasterSite) -> Forecaster:
    """Make a forecaster that ships or is installed; raises DefinitionError, whatever its package does."""
    try:
        forecaster: Forecaster = find_forecaster(name).load()(site)
    except PhyAgentOSError:
        raise
    except list_foreign_errors() as error:
        raise DefinitionError.of(
            "BROKEN_PYTHON",
            "lookahead.forecasters",
            found=f"forecaster {name!r}, which does not open: {type(error).__name__}: {error}",
        ) from error
    return forecaster
