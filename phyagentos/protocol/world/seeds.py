"""Seeds: every random choice of a run descends from one number by name, so that any part can be repeated alone."""

import hashlib


def compute_seed(root_seed: int, *purpose: str | int) -> int:
    """A seed in 0 .. 2**63 - 1 for one purpose, the same on every machine.

    `purpose` distinguishes this use from every other (`"node", "red", "attempt", 0`).
    """
    text = "/".join(str(part) for part in (root_seed, *purpose))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") & (2**63 - 1)
