"""Tasks in Luanti: the library of the benchmark, and its tasks."""
