"""Parts of `benchmarks/unseen.py`: rooms, goals and faults, what is feasible, and what came of it."""
