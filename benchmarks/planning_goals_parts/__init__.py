"""Parts of `planning_goals.py`."""
