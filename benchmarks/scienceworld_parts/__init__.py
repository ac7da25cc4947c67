"""Tasks of ScienceWorld: the library of the benchmark, and goals from descriptions."""
