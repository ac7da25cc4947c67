"""Parts of `benchmarks/perception.py`: worlds with cameras, what is stated of them, and how often that is true."""
