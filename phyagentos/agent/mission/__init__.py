"""Pursuit of a goal: the loop, the goal controller, the worklist, the report."""
