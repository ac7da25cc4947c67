"""LIBERO as a benchmark: its process, its tasks as projects, and the figures."""
