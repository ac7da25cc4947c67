"""The figures of a run, each with the episodes that it is made of; and of two sets of episodes, paired by seed.

Pairs are compared by McNemar's exact test (McNemar 1947, doi:10.1007/BF02295996).
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import msgspec
import numpy as np

from phyagentos.bench.held import HeldRow, compare_held
from phyagentos.bench.records import AXES, BY_NAME, EpisodeRecord, Order, select
from phyagentos.bench.report import Rate, Spread, Threshold
from phyagentos.bench.suite_file import Figure, FigureThreshold, Suite
from phyagentos.bench.sweep import Manifest
from phyagentos.errors import DefinitionError

GROUPED = ("pass", "policy", "setting", "verification")  # axes of a row, beside its task
SIGNIFICANT = 0.05
ONE_PASS = "seeds"  # where a suite names no pass
Key = tuple[str, ...]
_SUMMED = (Figure.FALSE_SUCCESSES, Figure.FALSE_FAILURES, Figure.MEMORY_CHANGED, Figure.CONTACTS)  # others are means
_SHARES = (Figure.FINAL, Figure.FIRST, Figure.PARTS, Figure.FIRST_PARTS)


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One row of a report: a task, or all of them, under one pass, policy, setting and mode.

    Attributes:
        episodes: Ids of the episodes that ended, from which every figure of the row comes.
        missing: Episodes that cannot run here; `pending` may still run.
        false_successes: Ids of episodes with a verdict `success` that the scorer denies.
        false_failures: Ids of those whose success the verdict denies.
        ticks: Control periods (actions) of an episode.
        repeats: How often an episode failed at a node and by a cause as an earlier one of its task and setting had,
            of the chances to; earlier passes count.
        action_ms: Wall time of a session for one of its actions [ms].
        taxa: Kinds of failure of episodes; `missed_sessions` those of sessions.
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
    repeats: Rate
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
    """A whole run; `versions` are those of framework, settings and memory, and how many episodes ran with each.

    Attributes:
        switches: Setting -> what it changes.
        held: What decided the episodes, and whether it was the same for every task.
        retention: Setting -> pass -> share of tasks met without any repair, at each seed in order.
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
    switches: dict[str, str]
    held: tuple[HeldRow, ...]
    retention: dict[str, dict[str, tuple[float, ...]]]
    episodes: tuple[EpisodeRecord, ...]

    @property
    def holds(self) -> bool:
        """Whether nothing is missing or pending, and all that was asked for holds."""
        return not (self.missing or self.pending) and all(each.holds for each in self.promises)


def summarise(suite: Suite, manifest: Manifest, records: Sequence[EpisodeRecord]) -> Summary:
    """The figures of a run as far as it is."""
    done = {record.id: record for record in records}
    missing = {id: "; ".join(map(str, why)) for id, why in manifest.missing.items() if id not in done}
    groups: dict[tuple[str, ...], list[Order]] = {}
    tasks = {order.task for order in manifest.orders}
    for order in manifest.orders:
        for task in (order.task, *([""] if len(tasks) > 1 else [])):
            groups.setdefault((*(getattr(order, BY_NAME[axis]) for axis in GROUPED), task), []).append(order)
    repeats = count_repeats([done[order.id] for order in manifest.orders if order.id in done])
    ordered = sorted(groups.items(), key=lambda item: [item[0][:-1], item[0][-1] == ""])
    return Summary(
        suite=suite.suite,
        objective=suite.objective,
        at=manifest.at,
        rows=tuple(
            _make_row(*key, orders=orders, missing=missing, done=done, repeats=repeats) for key, orders in ordered
        ),
        promises=tuple(_keep(asked, records) for asked in suite.asked),
        missing=missing,
        pending=tuple(order.id for order in manifest.orders if order.id not in done and order.id not in missing),
        versions={
            name: dict(Counter(found for record in records if (found := getattr(record, name))))
            for name in ("version", "settings", "memory_before")
        },
        switches={
            name: "; ".join(
                f"{key} {value}" for key, value in each.model_dump(mode="json", exclude_defaults=True).items()
            )
            for name, each in suite.settings.items()
        },
        held=compare_held(records),
        retention=follow_seeds([done[order.id] for order in manifest.orders if order.id in done]),
        episodes=tuple(sorted(records, key=lambda record: record.id)),
    )


def compute_figure(asked: FigureThreshold, records: Sequence[EpisodeRecord]) -> float:
    """A figure of a run; NaN where there is nothing that it could be computed from."""
    chosen, others = select(records, asked.where), select(records, asked.than or {})
    if asked.figure in {Figure.P_VALUE, Figure.OTHER_BITS}:
        if not (chosen and others):
            return float("nan")
        found = compare(others, chosen, Figure.OTHER_BITS if asked.figure is Figure.OTHER_BITS else asked.of)
        return found.p if asked.figure is Figure.P_VALUE else float(len(found.gained) + len(found.lost))
    value = _compute(asked.figure, asked.part, chosen)
    return value - _compute(asked.figure, asked.part, others) if asked.than is not None else value


def _compute(figure: Figure, part: str, records: Sequence[EpisodeRecord]) -> float:
    if figure is Figure.STAGE_MS:
        sessions = (session for record in records for session in record.sessions)
        return Spread.of([session.stages_ms[part] for session in sessions if part in session.stages_ms]).median
    if figure in _SUMMED:
        return float(sum(_list_values(records, figure)))
    values = _list_values(records, figure, part)
    return float(np.mean(values)) if values else float("nan")


def _keep(asked: FigureThreshold, records: Sequence[EpisodeRecord]) -> Promise:
    bound = asked.at_least if asked.at_least is not None else asked.at_most
    assert bound is not None  # a suite without it is refused
    ask, value = Threshold(bound, at_least=asked.at_least is not None), compute_figure(asked, records)
    where, than = (", ".join(map(" ".join, each.items())) for each in (asked.where, asked.than or {}))
    of = asked.part or (asked.of if asked.figure is Figure.P_VALUE else "")
    words = (asked.figure.value, of and f"of {of}", where and f"with {where}", than and f"against {than}")
    return Promise(figure=" ".join(filter(None, words)), value=value, asked=str(ask), holds=ask.holds(value))


def _list_values(records: Sequence[EpisodeRecord], figure: Figure, part: str = "") -> list[float]:
    each = [pair for record in records for pair in read_values(record, figure).items()]
    return [float(value) for name, value in each if part in {"", name}]


def count_repeats(records: Sequence[EpisodeRecord]) -> dict[str, Rate]:
    """Episode -> how often it failed as an earlier one of its task, policy, setting and mode, of the chances to."""
    known: dict[Key, set[tuple[str, str]]] = {}
    found: dict[str, Rate] = {}
    for record in records:
        earlier = known.setdefault(
            (record.task, record.state, record.policy, record.setting, record.verification), set()
        )
        failed = {(session.node, session.cause) for session in record.sessions if session.taxon}
        found[record.id] = Rate(len(earlier & failed), len(earlier))
        earlier |= failed
    return found


def follow_seeds(records: Sequence[EpisodeRecord]) -> dict[str, dict[str, tuple[float, ...]]]:
    """Setting -> pass -> share of tasks whose goal was met without any repair, at each seed in order."""
    grouped: dict[str, dict[str, dict[int, list[bool]]]] = {}
    for record in records:
        passes = grouped.setdefault(name_setting(record.policy, record.setting, record.verification), {})
        passes.setdefault(record.phase or ONE_PASS, {}).setdefault(record.seed, []).append(record.is_first)
    return {
        setting: {name: tuple(float(np.mean(each)) for each in seeds.values()) for name, seeds in passes.items()}
        for setting, passes in grouped.items()
    }


def name_setting(*axes: str) -> str:
    """The name of policy, setting and mode of verification together."""
    return " ".join(filter(None, axes)) or "all"


def _make_row(
    *key: str,
    orders: Sequence[Order],
    missing: dict[str, str],
    done: dict[str, EpisodeRecord],
    repeats: Mapping[str, Rate],
) -> Row:
    records = [done[order.id] for order in orders if order.id in done]
    sessions = [session for record in records for session in record.sessions]
    absent = sum(order.id in missing for order in orders)
    shares = {each.value: _list_values(records, each) for each in _SHARES}
    stages = sorted({stage for session in sessions for stage in session.stages_ms})
    return Row(
        axes=dict(zip(GROUPED, key, strict=False)),
        task=key[-1],
        episodes=tuple(record.id for record in records),
        missing=absent,
        pending=len(orders) - len(records) - absent,
        **{name: Rate(int(sum(values)), len(values)) for name, values in shares.items()},
        repeats=Rate(
            sum(repeats[record.id].successes for record in records),
            sum(repeats[record.id].trials for record in records),
        ),
        verdicts=dict(Counter(record.verdict or record.ended for record in records)),
        false_successes=tuple(record.id for record in records if record.is_false_success),
        false_failures=tuple(record.id for record in records if record.is_false_failure),
        sessions=len(sessions),
        ticks=Spread.of([float(sum(session.ticks for session in record.sessions)) for record in records]),
        sim_time_s=Spread.of([record.sim_time_s for record in records]),
        wall_s=Spread.of([record.wall_s for record in records]),
        action_ms=Spread.of([1e3 * session.wall_s / session.ticks for session in sessions if session.ticks]),
        stages_ms={name: Spread.of([s.stages_ms[name] for s in sessions if name in s.stages_ms]) for name in stages},
        taxa=dict(Counter(record.taxon for record in records if record.taxon)),
        missed_sessions=dict(Counter(session.taxon for session in sessions if session.taxon)),
    )


@dataclass(frozen=True, slots=True)
class Comparison:
    """What B is against A, on the pairs.

    Attributes:
        only_a: Episodes without a partner; `only_b` likewise.
        gained: Pairs in which B has more; `lost`, in which A has.
        p: Two-sided p value of the difference.
    """

    a: Rate
    b: Rate
    gained: tuple[Key, ...]
    lost: tuple[Key, ...]
    only_a: tuple[Key, ...]
    only_b: tuple[Key, ...]
    p: float

    def is_regression(self, significant: float = SIGNIFICANT) -> bool:
        """Whether B is significantly worse, or lacks episodes that A has: a gap may hide anything."""
        return bool(self.only_a) or (len(self.lost) > len(self.gained) and self.p <= significant)

    def __str__(self) -> str:
        """Both rates, and a line for each kind of pair that is no tie."""
        lines = [f"A {self.a}", f"B {self.b}", f"gained {len(self.gained)}, lost {len(self.lost)}, p = {self.p:.4g}"]
        listed = {"lost": self.lost, "gained": self.gained, "only in A": self.only_a, "only in B": self.only_b}
        lines += [f"  {title}: {' '.join(filter(None, key))}" for title, keys in listed.items() for key in keys]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        return f"<pre>{escape(str(self))}</pre>"


def compare(a: Sequence[EpisodeRecord], b: Sequence[EpisodeRecord], of: Figure = Figure.FINAL) -> Comparison:
    """Pair the episodes of two sets by seed and every axis but those on which each has one value of its own.

    Raises DefinitionError `INVALID_VALUE` where no episode of one set belongs to one of the other.
    """
    values = {axis: [{getattr(record, axis) for record in each} for each in (a, b)] for axis in AXES}
    free = [axis for axis, (ours, theirs) in values.items() if ours != theirs and len(ours) == len(theirs) == 1]
    ours, theirs = _index(a, free, of), _index(b, free, of)
    pairs = [key for key in ours if key in theirs]
    if not pairs:
        expected = "runs that share tasks and seeds"
        raise DefinitionError.of("INVALID_VALUE", "paos bench compare", "no episode of both", expected)
    gained = tuple(key for key in pairs if theirs[key] > ours[key])
    lost = tuple(key for key in pairs if ours[key] > theirs[key])
    from scipy.stats import binomtest, wilcoxon  # half a second to load, for comparisons alone

    p = 1.0
    if (differing := len(gained) + len(lost)) and of is Figure.SESSIONS:
        p = float(wilcoxon([ours[key] - theirs[key] for key in pairs]).pvalue)
    elif differing:
        p = float(binomtest(len(gained), differing).pvalue)
    return Comparison(
        a=Rate(sum(bool(ours[key]) for key in pairs), len(pairs)),
        b=Rate(sum(bool(theirs[key]) for key in pairs), len(pairs)),
        gained=gained,
        lost=lost,
        only_a=tuple(key for key in ours if key not in theirs),
        only_b=tuple(key for key in theirs if key not in ours),
        p=p,
    )


def read_values(record: EpisodeRecord, of: Figure) -> Mapping[str, Any]:
    """What a figure is made of, in one episode: of each part of its goal, or of an empty name."""
    match of:
        case Figure.PARTS:
            return record.parts
        case Figure.FIRST_PARTS:
            return record.first_parts
        case Figure.VERIFIED:
            return {"": bool(record.is_met) and record.verdict == "success"}
        case Figure.FIRST:
            return {"": record.is_first}
        case Figure.SESSIONS:
            return {"": len(record.sessions)}
        case Figure.OTHER_BITS:
            return {"": record.bits}
        case Figure.FALSE_SUCCESSES:
            return {"": record.is_false_success}
        case Figure.FALSE_FAILURES:
            return {"": record.is_false_failure}
        case Figure.MEMORY_CHANGED:
            return {"": record.memory in {"frozen", "emptied"} and record.memory_before != record.memory_after}
        case Figure.CONTACTS:
            return {"": sum(session.contacts for session in record.sessions)}
        case _:
            return {"": bool(record.is_met)}


def _index(records: Sequence[EpisodeRecord], free: Sequence[str], of: Figure) -> dict[Key, Any]:
    kept = [axis for axis in AXES if axis not in free]
    return {
        (*filter(None, (getattr(record, axis) for axis in kept)), str(record.seed), *filter(None, (part,))): value
        for record in records
        for part, value in read_values(record, of).items()
    }
