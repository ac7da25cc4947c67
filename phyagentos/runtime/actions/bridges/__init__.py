"""Conversions of action chunks between what a skill speaks and what a target takes, chosen in preflight."""
