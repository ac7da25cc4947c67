"""Goals, faults and judging eyes of the benchmark of recovery."""
