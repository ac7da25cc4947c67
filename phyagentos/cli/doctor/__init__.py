"""`paos doctor`: whether this machine can run what the project promises, and what to do where it cannot."""
