"""From evidence to a verdict with a typed cause."""
