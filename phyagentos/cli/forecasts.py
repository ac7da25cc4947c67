"""Forecasts for people: that of a session (`lookahead.json` of its evidence), and how good they were."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from phyagentos.bench.report import Rate
from phyagentos.cli.arguments import AsJson, choose_newest
from phyagentos.cli.outcome import print_json, print_note, print_result
from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.calibration import Scored, compute_record, compute_reliability
from phyagentos.protocol.sessions.lookahead import LookaheadResult, Outcomes, read_lookahead
from phyagentos.protocol.sessions.strategy import Strategy
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


def find_forecast(folder: Path) -> dict[str, Any] | None:
    """The forecast of a bundle as data; None when none was made, and with a note when it cannot be read."""
    try:
        result = read_lookahead(folder)
    except ExecutionError as error:
        print_note(str(error))
        return None
    return None if result is None else _describe(result)


def render_forecast(forecast: Mapping[str, Any]) -> Iterator[str]:
    """Lines for people."""
    for name, record in forecast["withheld"].items():
        yield f"not asked: {name}, {record}"
    if not forecast["rollouts"]:
        return
    yield (
        f"foreseen {_show_chance(forecast)} success: "
        f"{forecast['succeeded']:.4g} of {forecast['rollouts']} {forecast['cases']}, {forecast['threshold']:g} asked"
        f"{'; refused' if forecast['is_low'] else ''} ({forecast['cost_ms']:.0f} ms)"
    )
    if forecast["causes"]:
        yield f"         likely to fail of {forecast['likely_cause']}: {_list_causes(forecast['causes'])}"
    for way in forecast["alternatives"]:
        changed = msgspec.convert(way["strategy"], Strategy) or "nothing changed"
        failed = f", {_list_causes(way['causes'])}" if way["causes"] else ""
        yield f"         with {changed}: {way['succeeded']:.4g} of {way['rollouts']}{failed}"
    for other in forecast["others"]:
        yield f"         beside it {_show_chance(other)} by {other['forecaster']} ({other['cost_ms']:.0f} ms)"


def _describe(result: LookaheadResult) -> dict[str, Any]:
    return _describe_outcomes(result) | {
        "cases": result.cases,
        "is_low": result.is_low,
        "alternatives": [_describe_outcomes(each) for each in result.alternatives],
        "others": [_describe_outcomes(each) for each in result.others],
        "withheld": {name: str(record) for name, record in result.withheld.items()},
    }


def _describe_outcomes(outcomes: Outcomes) -> dict[str, Any]:
    facts: dict[str, Any] = msgspec.to_builtins(outcomes)
    interval = [round(bound, 4) for bound in outcomes.interval]
    named = {"rollouts": facts.pop("samples"), "likely_cause": outcomes.likely_cause}
    return facts | named | {"probability": round(outcomes.share, 4), "interval": interval}


def _show_chance(found: Mapping[str, Any]) -> str:
    low, high = found["interval"]
    return f"{100 * found['probability']:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"


def _list_causes(causes: Mapping[str, float]) -> str:
    return ", ".join(f"{cause} ({count:.4g})" for cause, count in sorted(causes.items(), key=lambda each: -each[1]))
