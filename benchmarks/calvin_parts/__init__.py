"""CALVIN as a project of this framework."""
