"""Time as an argument: every part that waits or stamps takes a `Clock`."""

import datetime
import threading
import time
from typing import Protocol


class Clock(Protocol):
    """A source of time."""

    def now_s(self) -> float:
        """Monotonic seconds; only differences mean anything."""

    def wall_iso(self) -> str:
        """UTC wall time, `2026-11-21T14:31:07.123456Z`, for people and records."""

    def sleep(self, seconds: float) -> None:
        """Wait `seconds` [s] of this clock."""


class SystemClock:
    """The machine's own clock."""

    _second = (-1, "")  # the latest one, as text: every record is stamped

    def now_s(self) -> float:
        """Monotonic seconds since an arbitrary start."""
        return time.perf_counter()

    def wall_iso(self) -> str:
        """UTC wall time with microseconds."""
        second, microsecond = divmod(time.time_ns() // 1000, 1_000_000)
        known, text = self._second
        if known != second:
            text = datetime.datetime.fromtimestamp(second, datetime.UTC).strftime("%Y-%m-%dT%H:%M:%S")
            self._second = (second, text)
        return f"{text}.{microsecond:06d}Z"

    def sleep(self, seconds: float) -> None:
        """Block this thread."""
        threading.Event().wait(seconds)


def compute_seconds(start: str, end: str) -> float:
    """Wall time between two stamps of `Clock.wall_iso` [s]."""
    begin, stop = (datetime.datetime.fromisoformat(stamp) for stamp in (start, end))
    return (stop - begin).total_seconds()
