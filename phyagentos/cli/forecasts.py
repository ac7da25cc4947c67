"""The forecast of a session (`lookahead.json` of its evidence) for people; `paos preflight` only shows it."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec

from phyagentos.bench.report import Rate
from phyagentos.cli.outcome import print_note
from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.lookahead import Alternative, LookaheadResult, read_lookahead
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
    low, high = forecast["interval"]
    yield (
        f"foreseen {100 * forecast['probability']:.0f} % [{100 * low:.0f}, {100 * high:.0f}] success: "
        f"{forecast['succeeded']} of {forecast['rollouts']} rollouts, {forecast['threshold']:g} asked"
        f"{'; refused' if forecast['is_low'] else ''} ({forecast['cost_ms']:.0f} ms)"
    )
    if forecast["causes"]:
        yield f"         likely to fail of {forecast['likely_cause']}: {_list_causes(forecast['causes'])}"
    for way in forecast["alternatives"]:
        changed = msgspec.convert(way["strategy"], Strategy) or "nothing changed"
        failed = f", {_list_causes(way['causes'])}" if way["causes"] else ""
        yield f"         with {changed}: {way['succeeded']} of {way['rollouts']}{failed}"


def _describe(result: LookaheadResult) -> dict[str, Any]:
    low, high = Rate(result.succeeded, result.samples).interval
    return {
        "probability": round(result.share, 4),
        "interval": [round(low, 4), round(high, 4)],
        "succeeded": result.succeeded,
        "rollouts": result.samples,
        "threshold": result.threshold,
        "is_low": result.is_low,
        "likely_cause": result.likely_cause,
        "causes": dict(result.causes),
        "cost_ms": round(result.cost_ms, 1),
        "alternatives": [_describe_way(each) for each in result.alternatives],
    }


def _describe_way(way: Alternative) -> dict[str, Any]:
    return {
        "strategy": msgspec.to_builtins(way.strategy),
        "probability": round(way.share, 4),
        "succeeded": way.succeeded,
        "rollouts": way.samples,
        "causes": dict(way.causes),
    }


def _list_causes(causes: Mapping[str, int]) -> str:
    return ", ".join(f"{cause} ({count})" for cause, count in sorted(causes.items(), key=lambda each: -each[1]))
