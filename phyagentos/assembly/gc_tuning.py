"""How often Python looks for cyclic garbage in a long-lived process of ours."""

import gc

YOUNG = 50_000  # allocations; what a session makes is let go by reference counts


def collect_rarely() -> None:
    """Freeze what was loaded at the start, and collect less often: records and sessions are trees without cycles."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(YOUNG, 20, 50)
