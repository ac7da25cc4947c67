"""A goal in ScienceWorld for the suites `constant` and `game_to_arm`."""
