"""How soon a long-lived process runs once it is woken, and how often it collects garbage.

A woken process may wait for the next tick of the scheduler, 4 ms, and longer on a busy machine; one with a real-time
priority does not. Only the supervisor asks for it, the lowest one, since it sleeps nearly all the time; not on a single
processor, nor where a world keeps real time, which it would delay. Its children begin with ordinary scheduling.
World and worker that keep real time ask for a larger share instead, which starves no process: a late command makes the
target stop.
"""

import ctypes
import gc
import os
import signal

from phyagentos.fork_server import FORKED_FOR, end_with_requester

YOUNG = 50_000  # allocations; what a session makes is let go by reference counts
PRECEDENCE = -10  # the nice value of what keeps real time: nine times the share of an ordinary process
PR_SET_PDEATHSIG = 1  # Linux: the signal that a process gets when its parent ends
PRIORITY = 1  # of 1..99: in front of ordinary processes, behind everything else that asks


def ask_for_prompt_wakeups() -> bool:
    """Let this thread run as soon as it is woken, in front of ordinary processes; whether that was granted."""
    if len(os.sched_getaffinity(0)) < 2:
        return False
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(PRIORITY))
    except OSError:  # a right that an ordinary user rarely has; `paos doctor` shows it
        return False
    return True


def ask_for_precedence() -> bool:
    """Let this thread run before ordinary processes when both could; whether that was granted. Children do not."""
    try:
        os.sched_setscheduler(0, os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, os.sched_param(0))
        os.setpriority(os.PRIO_PROCESS, 0, PRECEDENCE)
    except OSError:  # a right that an ordinary user rarely has
        return False
    return True


def collect_rarely() -> None:
    """Freeze what was loaded at the start, and collect less often: records and sessions are trees without cycles."""
    gc.freeze()
    gc.set_threshold(YOUNG, 20, 50)
    gc.enable()


def end_with(parent: int, by: signal.Signals = signal.SIGTERM) -> bool:
    """Let this process end `by` a signal when its parent ends; False where that is another one by now, or gone."""
    if os.environ.get(FORKED_FOR) == str(parent):
        return end_with_requester(parent, by)
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, by)
    return os.getppid() == parent
