"""The forecast of a session (`lookahead.json` of its evidence) for people, and as data."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec

from phyagentos.cli.outcome import print_note
from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.lookahead import LookaheadResult, Outcomes, read_lookahead
from phyagentos.protocol.sessions.strategy import Strategy


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
