"""How good forecasts were: those of every forecaster of some workspaces, compared with the verdicts.

python -m rollout_forecaster WORKSPACE...      # --json for programs
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import fmean

import msgspec

from phyagentos.bench.report import Rate
from phyagentos.errors import PhyAgentOSError
from phyagentos.protocol.sessions.calibration import Scored, TrackRecord, compute_record
from phyagentos.protocol.sessions.evidence import encode_json
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.forecast_record import collect_scored, read_forecasting

BINS = 5  # of the reliability table, equally wide


class Bin(msgspec.Struct, frozen=True):
    """Forecasts from `low` to `high`: how many, their mean, and how many of the sessions succeeded."""

    low: float
    high: float
    cases: int
    foreseen: float
    succeeded: int


class Calibration(TrackRecord, frozen=True, kw_only=True):
    """The track record of one forecaster.

    Attributes:
        is_asked: Whether goals still use it: enough cases that it foresees worse than the base rate exclude it.
        reliability: By bins of the chance of success, from unlikely to likely.
    """

    is_asked: bool
    reliability: tuple[Bin, ...]


def compute_reliability(scored: Sequence[Scored]) -> tuple[Bin, ...]:
    """The bins that hold forecasts, from unlikely to likely; a chance of 1 is in the last one."""
    bins: dict[int, list[Scored]] = {}
    for each in sorted(scored):
        bins.setdefault(min(int(each.chance * BINS), BINS - 1), []).append(each)
    return tuple(
        Bin(
            at / BINS, (at + 1) / BINS, len(mine), fmean(one.chance for one in mine), sum(one.succeeded for one in mine)
        )
        for at, mine in bins.items()
    )


def calibrate(scored: Sequence[Scored], least_cases: int) -> Calibration:
    """The calibration of a forecaster from at least one of its forecasts."""
    record = compute_record(scored)
    is_asked = not record.is_unfit(least_cases)
    return Calibration(**msgspec.structs.asdict(record), is_asked=is_asked, reliability=compute_reliability(scored))


def render(name: str, found: Calibration, least_cases: int) -> Iterator[str]:
    """Brier score and reliability of a forecaster, as lines."""
    use = "in use" if found.is_asked else "excluded: worse than the base rate"
    use += f"; {least_cases} are enough to exclude it" if found.cases < least_cases else ""
    yield f"{name}: {found} ({use})"
    yield "  forecast        mean    succeeded"
    for each in found.reliability:
        succeeded = Rate(each.succeeded, each.cases)
        yield f"  {100 * each.low:3.0f} to {100 * each.high:3.0f} %  {100 * each.foreseen:4.0f} %    {succeeded}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the calibration of every forecaster; exit code 1 where no session with a forecast has a verdict."""
    parser = argparse.ArgumentParser(prog="rollout_forecaster", description=__doc__)
    parser.add_argument("workspaces", nargs="+", type=Path, metavar="WORKSPACE", help="with sessions that were judged")
    parser.add_argument("--json", action="store_true", help="print one JSON object, by forecaster")
    given = parser.parse_args(arguments)
    scored: dict[str, list[Scored]] = {}
    try:
        workspaces = [Workspace.open(each) for each in given.workspaces]
        for workspace in workspaces:
            for name, some in collect_scored(workspace).items():
                scored.setdefault(name, []).extend(some)
        least_cases = read_forecasting(workspaces[0]).least_cases
    except PhyAgentOSError as error:
        print(error, file=sys.stderr)
        return 2
    found = {name: calibrate(each, least_cases) for name, each in scored.items()}
    if given.json:
        print(encode_json(found).decode(), end="")
    elif found:
        print("\n".join(line for name, each in found.items() for line in render(name, each, least_cases)))
    else:
        print("no session with a forecast has a verdict; `lookahead` of a goal requests forecasts", file=sys.stderr)
    return 0 if found else 1
