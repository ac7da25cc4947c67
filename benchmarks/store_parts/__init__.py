"""The parts of `benchmarks/store.py`, one question a file."""
