"""Two sets of episodes, paired by seed: McNemar's exact test (McNemar 1947, doi:10.1007/BF02295996)."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from scipy.stats import binomtest

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
        gained: Pairs that only B has right; `lost`, that only A has right.
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
    ours, theirs = _list_outcomes(a, free, of), _list_outcomes(b, free, of)
    pairs = [key for key in ours if key in theirs]
    if not pairs:
        expected = "runs that share tasks and seeds"
        raise DefinitionError.of("NOT_PAIRED", "paos bench compare", "no episode of both", expected)
    gained = tuple(key for key in pairs if theirs[key] and not ours[key])
    lost = tuple(key for key in pairs if ours[key] and not theirs[key])
    differing = len(gained) + len(lost)
    return Comparison(
        a=Rate(sum(ours[key] for key in pairs), len(pairs)),
        b=Rate(sum(theirs[key] for key in pairs), len(pairs)),
        gained=gained,
        lost=lost,
        only_a=tuple(key for key in ours if key not in theirs),
        only_b=tuple(key for key in theirs if key not in ours),
        p=float(binomtest(len(gained), differing).pvalue) if differing else 1.0,
    )


def list_outcomes(
    records: Iterable[EpisodeRecord], of: Figure, part: str = ""
) -> list[tuple[EpisodeRecord, str, bool]]:
    """What a share is made of: an episode, a part of its goal or an empty name, and whether it is there."""
    found: list[tuple[EpisodeRecord, str, bool]] = []
    for record in records:
        if of in {Figure.PARTS, Figure.FIRST_PARTS}:
            parts: Mapping[str, bool] = record.parts if of is Figure.PARTS else record.first_parts
            found += [(record, name, is_there) for name, is_there in parts.items() if part in {"", name}]
        else:
            found.append((record, "", record.is_first if of is Figure.FIRST else bool(record.is_met)))
    return found


def _is_free(axis: str, a: Sequence[EpisodeRecord], b: Sequence[EpisodeRecord]) -> bool:
    values = [{getattr(record, axis) for record in each} for each in (a, b)]
    return values[0] != values[1] and all(len(each) == 1 for each in values)


def _list_outcomes(records: Sequence[EpisodeRecord], free: Sequence[str], of: Figure) -> dict[Key, bool]:
    kept = [axis for axis in AXES if axis not in free]
    return {
        (
            *(value for axis in kept if (value := getattr(record, axis))),
            str(record.seed),
            *filter(None, (part,)),
        ): is_there
        for record, part, is_there in list_outcomes(records, of)
    }
