"""A limit on the time that a person's code takes, by the wall clock, where it runs in the main thread.

What is over its limit is interrupted where it stands, so that the error has the line that never ended. Code that holds
the interpreter, as one long call of a library may, is interrupted when it returns.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from typing_extensions import override

from phyagentos.clock import SystemClock

_limits: list[float] = []  # of the calls that are limited now, one within another [s]


class Overtime(BaseException):
    """What runs has taken longer than its limit [s]; no `except Exception` of it keeps it going."""

    @override
    def __str__(self) -> str:
        return f"it has run for {self.args[0]:.2g} s, and may no longer"


@contextmanager
def limit_time(limit_s: float) -> Iterator[None]:
    """Raise Overtime from what runs in this block after so long [s]; without a limit in other threads.

    Within another limit the one that ends first holds.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    clock = SystemClock()
    handler, began_s = signal.signal(signal.SIGALRM, _interrupt), clock.now_s()
    outer_s, interval_s = signal.getitimer(signal.ITIMER_REAL)
    _limits.append(min(limit_s, outer_s or limit_s))
    try:
        signal.setitimer(signal.ITIMER_REAL, _limits[-1])
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        _limits.pop()
        signal.signal(signal.SIGALRM, handler)
        if outer_s:
            signal.setitimer(signal.ITIMER_REAL, max(outer_s - (clock.now_s() - began_s), 1e-3), interval_s)


def renew_limit() -> None:
    """Begin the innermost limit anew: what it waits for shows signs of life."""
    if _limits and threading.current_thread() is threading.main_thread():
        signal.setitimer(signal.ITIMER_REAL, _limits[-1])


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise Overtime(_limits[-1])
