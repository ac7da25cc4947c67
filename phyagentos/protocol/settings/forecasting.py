"""The names of forecasters, as goal graphs use them (`lookahead`): what ships, and what packages announce."""

from collections.abc import Callable
from typing import Any

from phyagentos.errors import DefinitionError
from phyagentos.plugins import Plugins

SHIPPED = "rollouts"
FORECASTERS = Plugins[Callable[..., Any]](
    "phyagentos.forecasters",
    {SHIPPED: "phyagentos.runtime.lookahead.rollout_forecaster:open_rollouts"},
    unknown="UNKNOWN_FORECASTER",
)
"""What makes a forecaster: `open(site) -> Forecaster`, see `runtime.lookahead.forecaster`."""


def check_forecasters(names: tuple[str, ...]) -> tuple[str, ...]:
    """The names; raises ValueError for one that is no forecaster here."""
    for name in names:
        try:
            FORECASTERS.find(name, "lookahead.forecasters")
        except DefinitionError as error:
            raise ValueError(str(error)) from error
    return names
