"""Plug-in points for detectors, which find things in pictures by words."""
