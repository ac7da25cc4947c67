"""The names of forecasters, as goal graphs use them (`lookahead`): what ships, and what packages announce."""

from importlib.metadata import EntryPoint, entry_points

from phyagentos.errors import DefinitionError

FORECASTERS = "phyagentos.forecasters"
"""Entry point group of what makes a forecaster: `open(site) -> Forecaster`, see `runtime.lookahead.forecaster`."""
SHIPPED = EntryPoint("rollouts", "phyagentos.runtime.lookahead.rollout_forecaster:open_rollouts", FORECASTERS)


def find_forecaster(name: str) -> EntryPoint:
    """The forecaster of a name, not loaded; raises DefinitionError `UNKNOWN_FORECASTER`."""
    known: dict[str, EntryPoint] = {point.name: point for point in (*entry_points(group=FORECASTERS), SHIPPED)}
    if name not in known:
        raise DefinitionError.unknown("UNKNOWN_FORECASTER", "lookahead.forecasters", name, known)
    return known[name]


def check_forecasters(names: tuple[str, ...]) -> tuple[str, ...]:
    """The names; raises ValueError for one that is no forecaster here."""
    for name in names:
        try:
            find_forecaster(name)
        except DefinitionError as error:
            raise ValueError(str(error)) from error
    return names
