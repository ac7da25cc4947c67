"""The figures of a run, each with the episodes that it is made of."""

from collections import Counter
from collections.abc import Sequence

import msgspec

from phyagentos.bench.comparison import compare, list_outcomes
from phyagentos.bench.records import EpisodeRecord, Order, select
from phyagentos.bench.report import Ask, Rate, Spread
from phyagentos.bench.suite_file import Asked, Figure
from phyagentos.bench.sweep import Manifest


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One row of a report: a task, or all of them, under one pass, policy, setting and mode.

    Attributes:
        episodes: Ids of the episodes that ended, from which every figure of the row comes.
        missing: Episodes that cannot run here; `pending` may still run.
        false_successes: Ids of episodes with the verdict `success` that the scorer denies.
        false_failures: Ids of those whose success the verdict denies.
        ticks: Control periods (actions) of an episode.
        wall_s: Of an episode, its processes started [s].
        action_ms: Wall time of a session for one of its actions [ms].
        taxa: Kinds of failure of episodes.
        missed_sessions: The same of sessions.
    """

    axes: dict[str, str]
    task: str
    episodes: tuple[str, ...]
    missing: int
    pending: int
    final: Rate
    first: Rate
    parts: Rate
    first_parts: Rate
    verdicts: dict[str, int]
    false_successes: tuple[str, ...]
    false_failures: tuple[str, ...]
    sessions: int
    ticks: Spread
    sim_time_s: Spread
    wall_s: Spread
    action_ms: Spread
    stages_ms: dict[str, Spread]
    taxa: dict[str, int]
    missed_sessions: dict[str, int]


class Promise(msgspec.Struct, frozen=True, kw_only=True):
    """A figure that was asked for, and what it came to."""

    figure: str
    value: float
    asked: str
    holds: bool


class Summary(msgspec.Struct, frozen=True, kw_only=True):
    """A whole run.

    Attributes:
        missing: Id of an episode -> why it cannot run here.
        pending: Ids of episodes without a record.
        versions: Of the framework, settings and memory that episodes ran with, and how many did.
    """

    report: int = 1
    suite: str
    objective: str
    at: str
    rows: tuple[Row, ...]
    promises: tuple[Promise, ...]
    missing: dict[str, str]
    pending: tuple[str, ...]
    versions: dict[str, dict[str, int]]
    episodes: tuple[EpisodeRecord, ...]

    @property
    def holds(self) -> bool:
        """Whether nothing is missing or pending, and all that was asked for holds."""
        return not (self.missing or self.pending) and all(each.holds for each in self.promises)


def summarise(manifest: Manifest, records: Sequence[EpisodeRecord]) -> Summary:
    """The figures of a run as far as it is."""
    done = {record.id: record for record in records}
    groups: dict[tuple[str, ...], list[Order]] = {}
    for order in manifest.orders:
        group = (order.phase, order.policy, order.setting, order.verification)
        for task in (order.task, ""):
            groups.setdefault((*group, task), []).append(order)
    tasks = {order.task for order in manifest.orders}
    rows = [
        _make_row(
            dict(zip(("pass", "policy", "setting", "verification"), key, strict=False)), key[-1], orders, manifest, done
        )
        for key, orders in sorted(groups.items(), key=lambda item: [item[0][:4], item[0][4] == ""])
        if key[-1] or len(tasks) > 1
    ]
    return Summary(
        suite=manifest.suite,
        objective=manifest.objective,
        at=manifest.at,
        rows=tuple(rows),
        promises=tuple(_keep(asked, records) for asked in manifest.list_asked()),
        missing={id: "; ".join(map(str, problems)) for id, problems in manifest.missing.items() if id not in done},
        pending=tuple(o.id for o in manifest.orders if o.id not in done and o.id not in manifest.missing),
        versions={
            name: dict(Counter(str(getattr(record, name)) for record in records if getattr(record, name)))
            for name in ("version", "settings", "memory_before")
        },
        episodes=tuple(sorted(records, key=lambda record: record.id)),
    )


def compute_figure(asked: Asked, records: Sequence[EpisodeRecord]) -> float:
    """A figure of a run; NaN where there is nothing that it could be computed from."""
    chosen = select(records, asked.where)
    if asked.figure is Figure.P_VALUE:
        others = select(records, asked.than or {})
        return compare(others, chosen, asked.of).p if chosen and others else float("nan")
    value = _compute(asked.figure, asked.part, chosen)
    return value - _compute(asked.figure, asked.part, select(records, asked.than)) if asked.than is not None else value


def _compute(figure: Figure, part: str, records: Sequence[EpisodeRecord]) -> float:
    if figure is Figure.FALSE_SUCCESSES:
        return float(sum(record.is_false_success for record in records))
    if figure is Figure.FALSE_FAILURES:
        return float(sum(record.is_false_failure for record in records))
    if figure is Figure.MEMORY_CHANGED:
        return float(sum(record.memory_before != record.memory_after for record in records if record.is_frozen))
    return _make_rate(records, figure, part).value


def _keep(asked: Asked, records: Sequence[EpisodeRecord]) -> Promise:
    bound = asked.at_least if asked.at_least is not None else asked.at_most
    assert bound is not None  # the suite was checked
    ask, value = Ask(bound, at_least=asked.at_least is not None), compute_figure(asked, records)
    where = ", ".join(f"{axis} {name}" for axis, name in asked.where.items())
    than = ", ".join(f"{axis} {name}" for axis, name in (asked.than or {}).items())
    words = [
        asked.figure.value,
        asked.part and f"of {asked.part}",
        where and f"with {where}",
        than and f"against {than}",
    ]
    return Promise(figure=" ".join(filter(None, words)), value=value, asked=str(ask), holds=ask.holds(value))


def _make_rate(records: Sequence[EpisodeRecord], figure: Figure, part: str = "") -> Rate:
    outcomes = [is_there for _, _, is_there in list_outcomes(records, figure, part)]
    return Rate(sum(outcomes), len(outcomes))


def _make_row(
    axes: dict[str, str], task: str, orders: Sequence[Order], manifest: Manifest, done: dict[str, EpisodeRecord]
) -> Row:
    records = [done[order.id] for order in orders if order.id in done]
    sessions = [session for record in records for session in record.sessions]
    stages: dict[str, list[float]] = {}
    for session in sessions:
        for stage, ms in session.stages_ms.items():
            stages.setdefault(stage, []).append(ms)
    missing = sum(order.id in manifest.missing and order.id not in done for order in orders)
    return Row(
        axes=axes,
        task=task,
        episodes=tuple(record.id for record in records),
        missing=missing,
        pending=len(orders) - len(records) - missing,
        final=_make_rate(records, Figure.FINAL),
        first=_make_rate(records, Figure.FIRST),
        parts=_make_rate(records, Figure.PARTS),
        first_parts=_make_rate(records, Figure.FIRST_PARTS),
        verdicts=dict(Counter(record.verdict or record.ended for record in records)),
        false_successes=tuple(record.id for record in records if record.is_false_success),
        false_failures=tuple(record.id for record in records if record.is_false_failure),
        sessions=len(sessions),
        ticks=Spread.of([float(sum(session.ticks for session in record.sessions)) for record in records]),
        sim_time_s=Spread.of([record.sim_time_s for record in records]),
        wall_s=Spread.of([record.wall_s for record in records]),
        action_ms=Spread.of([1e3 * session.wall_s / session.ticks for session in sessions if session.ticks]),
        stages_ms={stage: Spread.of(values) for stage, values in sorted(stages.items())},
        taxa=dict(Counter(record.taxon for record in records if record.taxon)),
        missed_sessions=dict(Counter(session.taxon for session in sessions if session.taxon)),
    )
