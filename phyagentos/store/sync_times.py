"""How long the disk takes to make an append durable."""

import os
import statistics
import tempfile
from pathlib import Path

import msgspec

from phyagentos.clock import Clock

TRIES = 200
_BYTES = 512


class SyncTimes(msgspec.Struct, frozen=True, kw_only=True):
    """Number of tries, median and 99th percentile [ms]."""

    count: int
    p50_ms: float
    p99_ms: float


def measure_sync(folder: Path, clock: Clock) -> SyncTimes:
    """Append and `fdatasync` some hundred times, in a temporary file in `folder`; raises OSError."""
    times_ms = []
    with tempfile.NamedTemporaryFile(dir=folder, prefix=".measure-") as file:
        for _ in range(TRIES):
            begin_s = clock.now_s()
            os.write(file.fileno(), b"x" * _BYTES)
            os.fdatasync(file.fileno())
            times_ms.append((clock.now_s() - begin_s) * 1e3)
    cuts = statistics.quantiles(times_ms, n=100)
    return SyncTimes(count=TRIES, p50_ms=round(cuts[49], 3), p99_ms=round(cuts[98], 3))
