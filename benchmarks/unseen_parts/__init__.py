"""Parts of `benchmarks/unseen.py`: what came of drawn goals, and its figures."""
