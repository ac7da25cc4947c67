"""How good forecasts were, for people."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from phyagentos.bench.report import Rate
from phyagentos.cli.arguments import AsJson, choose_newest
from phyagentos.cli.outcome import print_json, print_note, print_result
from phyagentos.protocol.sessions.calibration import Scored, compute_record, compute_reliability
from phyagentos.protocol.workspace.workspace import Workspace


def show_forecasts(
    workspaces: Annotated[list[Path] | None, typer.Argument(help="Workspaces; the newest without.")] = None,
    as_json: AsJson = False,
) -> None:
    """Compare what forecasters foresaw of sessions with what happened: Brier score, reliability, who is asked."""
    from phyagentos.store.forecast_record import collect_scored, read_forecasting

    places = [Workspace.open(each) for each in workspaces or [choose_newest()]]
    scored: dict[str, list[Scored]] = {}
    for place in places:
        for name, found in collect_scored(place).items():
            scored.setdefault(name, []).extend(found)
    least = read_forecasting(places[0]).least_cases
    if as_json:
        print_json({name: _describe_worth(each, least) for name, each in scored.items()})
    elif scored:
        print_result("\n".join(line for name, each in scored.items() for line in render_worth(name, each, least)))
    else:
        print_note("no session with a forecast has a verdict; a goal asks for forecasts with `lookahead`")


def render_worth(name: str, scored: Sequence[Scored], least: int) -> Iterator[str]:
    """A forecaster's Brier score and reliability, as lines."""
    record = compute_record(scored)
    asked = "not asked: worse than the base rate" if record.is_unfit(least) else "asked"
    asked += f"; {least} are enough to say" if record.cases < least else ""
    yield f"{name}: {record} ({asked})"
    yield "  foreseen        mean    happened"
    for each in compute_reliability(scored):
        happened = Rate(each.succeeded, each.cases)
        yield f"  {100 * each.low:3.0f} to {100 * each.high:3.0f} %  {100 * each.foreseen:4.0f} %    {happened}"


def _describe_worth(scored: Sequence[Scored], least: int) -> dict[str, Any]:
    record = compute_record(scored)
    is_asked, bins = not record.is_unfit(least), compute_reliability(scored)
    return msgspec.structs.asdict(record) | {"is_asked": is_asked, "reliability": bins}
