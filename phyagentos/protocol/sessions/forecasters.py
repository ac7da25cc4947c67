"""The names of forecasters, as goal graphs use them (`lookahead`): what packages announce, and the kit `rollouts`."""

from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import EntryPoint
from importlib.util import find_spec
from typing import Any, cast

from phyagentos.errors import DefinitionError
from phyagentos.plugins import Plugins
from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.sessions.lookahead import DEFAULT_FORECASTER

KIT = "rollout_forecaster.forecaster:open_rollouts"
FORECASTERS = Plugins[Callable[..., Any]]("phyagentos.forecasters", noun="forecaster")
"""What makes a forecaster: `open(site) -> Forecaster`, see `runtime.lookahead.forecaster`."""


def find_forecaster(name: str) -> EntryPoint:
    """The forecaster of a name, not loaded: an installed one, or the kit `rollouts` on the path of Python.

    Raises:
        DefinitionError: `UNKNOWN_NAME`, for the kit with the command that installs it; `DUPLICATE_NAME`.
    """
    address, is_announced = "lookahead.forecasters", DEFAULT_FORECASTER in FORECASTERS.names()
    if name == DEFAULT_FORECASTER and not is_announced and find_spec(KIT.partition(".")[0]) is None:
        found = f"{name!r}, a kit that is not installed"
        hint = f"Install it: pip install {find_shipped_root() / 'kits' / DEFAULT_FORECASTER}"
        raise DefinitionError.of("UNKNOWN_NAME", address, found, hint=hint, kind="forecaster")
    known = FORECASTERS if is_announced else replace(FORECASTERS, shipped={DEFAULT_FORECASTER: KIT})
    return cast(EntryPoint, known.find(name, address))
