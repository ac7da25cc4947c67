"""Parts of `benchmarks.overhead`: what runs in the Python of an environment, and a session on the ordinary path."""
