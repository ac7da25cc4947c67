"""How often Python looks for cyclic garbage in a long-lived process of ours."""

import gc

YOUNG = 50_000  # allocations; what a session makes is let go by reference counts


def collect_rarely() -> None:
    """Leave what was loaded at the start out of every collection, and collect less often.

    Records and sessions are trees without cycles, so a collection finds nothing, and walks all that is kept to find it.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(YOUNG, 20, 50)
