"""Scorers: eyes of their own, which say what was achieved whatever the verdict was."""
