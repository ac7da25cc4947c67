"""Temporal ensemble: the weighted mean of all chunks that speak of a moment. Zhao et al. 2023, arXiv:2304.13705."""

from dataclasses import dataclass, field

import numpy as np

from phyagentos.runtime.actions.set_points import Array


@dataclass(slots=True)
class TemporalEnsemble:
    """The chunks that still speak of a moment to come.

    Attributes:
        decay: m of the weights exp(-m i), where i = 0 is the oldest chunk.
    """

    decay: float
    _chunks: list[tuple[int, Array]] = field(default_factory=list)

    def blend(self, after: int, rows: Array) -> Array:
        """The mean, (k, width), at the moments of the newest chunk, whose row i is due `after` + i + 1 periods on."""
        self._chunks = [(begin, each) for begin, each in self._chunks if begin + len(each) > after]
        self._chunks.append((after, rows))
        mean, weight, rank = np.zeros_like(rows), np.zeros((len(rows), 1)), np.zeros((len(rows), 1))
        for begin, each in self._chunks:
            shared = slice(max(begin - after, 0), min(begin + len(each) - after, len(rows)))
            share = np.exp(-self.decay * rank[shared])
            mean[shared] += share * each[shared.start + after - begin : shared.stop + after - begin]
            weight[shared] += share
            rank[shared] += 1
        return np.asarray(mean / weight)

    def clear(self) -> None:
        """Forget all chunks."""
        self._chunks.clear()
