"""The names of forecasters, as goal graphs use them (`lookahead`): what packages announce, and the kit `rollouts`."""

from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import find_shipped_root

FORECASTERS = "phyagentos.forecasters"
"""Entry point group of what makes a forecaster: `open(site) -> Forecaster`, see `runtime.lookahead.forecaster`."""
DEFAULT = "rollouts"  # of a goal that requests look-ahead and names no forecaster
KIT = EntryPoint(DEFAULT, "rollout_forecaster.forecaster:open_rollouts", FORECASTERS)


def find_forecaster(name: str) -> EntryPoint:
    """The forecaster of a name, not loaded: an installed one, or the kit `rollouts` on the path of Python.

    Raises:
        DefinitionError: `UNKNOWN_FORECASTER`, for the kit with the command that installs it.
    """
    known: dict[str, EntryPoint] = {point.name: point for point in entry_points(group=FORECASTERS)}
    if find_spec(KIT.module.partition(".")[0]) is not None:
        known.setdefault(KIT.name, KIT)
    if name not in known:
        address = "lookahead.forecasters"
        if name == KIT.name:
            found = f"{name!r}, a kit that is not installed"
            hint = f"Install it: pip install {find_shipped_root() / 'kits' / KIT.name}"
            raise DefinitionError.of("UNKNOWN_FORECASTER", address, found, hint=hint)
        raise DefinitionError.unknown("UNKNOWN_FORECASTER", address, name, (*known, KIT.name))
    return known[name]


def check_forecasters(names: tuple[str, ...]) -> tuple[str, ...]:
    """The names; raises ValueError for one that is no forecaster here."""
    for name in names:
        try:
            find_forecaster(name)
        except DefinitionError as error:
            raise ValueError(str(error)) from error
    return names
