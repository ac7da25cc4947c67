"""Parts of `benchmarks/view.py`."""
