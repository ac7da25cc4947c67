"""Two sets of episodes, paired by seed: McNemar's exact test (McNemar 1947, doi:10.1007/BF02295996)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from scipy.stats import binomtest, wilcoxon

from phyagentos.bench.records import AXES, EpisodeRecord
from phyagentos.bench.report import Rate
from phyagentos.bench.suite_file import Figure
from phyagentos.errors import DefinitionError

SIGNIFICANT = 0.05
Key = tuple[str, ...]


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


def compare(a: Sequence[EpisodeRecord], b: Sequence[EpisodeRecord], of: Figure = Figure.FINAL) -> Comparison:
    """Pair the episodes of two sets by seed and every axis but those on which each has one value of its own.

    Raises:
        DefinitionError: `NOT_PAIRED` where no episode of one set belongs to one of the other.
    """
    free = [axis for axis in AXES if _is_free(axis, a, b)]
    ours, theirs = _index(a, free, of), _index(b, free, of)
    pairs = [key for key in ours if key in theirs]
    if not pairs:
        expected = "runs that share tasks and seeds"
        raise DefinitionError.of("NOT_PAIRED", "paos bench compare", "no episode of both", expected)
    gained = tuple(key for key in pairs if theirs[key] > ours[key])
    lost = tuple(key for key in pairs if ours[key] > theirs[key])
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
        case _:
            return {"": bool(record.is_met)}


def _is_free(axis: str, a: Sequence[EpisodeRecord], b: Sequence[EpisodeRecord]) -> bool:
    values = [{getattr(record, axis) for record in each} for each in (a, b)]
    return values[0] != values[1] and all(len(each) == 1 for each in values)


def _index(records: Sequence[EpisodeRecord], free: Sequence[str], of: Figure) -> dict[Key, Any]:
    kept = [axis for axis in AXES if axis not in free]
    return {
        (*filter(None, (getattr(record, axis) for axis in kept)), str(record.seed), *filter(None, (part,))): value
        for record in records
        for part, value in read_values(record, of).items()
    }
