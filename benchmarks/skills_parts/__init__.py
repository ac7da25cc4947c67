"""Instances of skills, drawn from seeds, and their judge."""
