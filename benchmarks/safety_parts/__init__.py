"""The parts of `benchmarks/safety.py`: who attacks, what is sent, who looks, and how long a stop takes."""
