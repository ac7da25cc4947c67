"""Seeds: every random choice of a run descends from one number by name, so that any part can be repeated alone."""

import hashlib


def compute_seed(root_seed: int, *purpose: str | int) -> int:
    """A 63-bit seed for one purpose.

    Args:
        root_seed: The run's seed.
        purpose: Names and numbers that tell this use from every other (`"node", "red", "attempt", 0`).

    Returns:
        A number in 0 .. 2**63 - 1, the same on every machine.
    """
    text = "/".join(str(part) for part in (root_seed, *purpose))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") & (2**63 - 1)
