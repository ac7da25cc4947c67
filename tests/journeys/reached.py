"""Which rows of both statecharts the workspaces below a folder have gone through: journals and logs of phases."""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path

from phyagentos.protocol.sessions.statechart import Row
from phyagentos.store.follower import Follower

Arrow = tuple[str, str, str]  # from, event, to


def list_arrows(rows: Iterable[Row]) -> set[Arrow]:
    """The arrows of a table."""
    return {(source.value, row.trigger, row.dest.value) for row in rows for source in row.sources}


def read_session_arrows(base: Path) -> set[Arrow]:
    """Every change of state that a journal below `base` records."""
    lanes = {segment.parent.resolve() for segment in base.glob("**/sessions/*/*.001.md")}
    return {arrow for lane in lanes for arrow in _iter_records(lane)}


def read_phase_arrows(base: Path) -> set[Arrow]:
    """Every change of phase that a log of a target below `base` tells."""
    lines = (line for log in base.glob("**/logs/events-*.jsonl") for line in log.read_text("utf-8").splitlines())
    return {(each["from"], each["ev"], each["to"]) for each in map(json.loads, lines)}


def _iter_records(lane: Path) -> Iterator[Arrow]:
    follower = Follower(lane)
    for record in follower.read_new():
        if record.source is not None and record.to is not None:
            yield record.source, record.ev, record.to
    follower.close()
