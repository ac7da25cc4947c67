"""The ordinary path, run many times, and what came of it in numbers."""
