"""Sessions without work."""

from pathlib import Path


def measure_noop(folder: Path, sessions: int, hosts: int) -> dict[str, float]:
    """To be measured."""
    return {}
