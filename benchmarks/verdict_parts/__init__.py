"""What `benchmarks/verdicts.py` is made of: recorded sessions, worlds that went wrong, another eye, and the table."""
