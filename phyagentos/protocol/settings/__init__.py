"""Settings files that people own, with their schemas."""
