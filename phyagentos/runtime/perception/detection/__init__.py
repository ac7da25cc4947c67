"""Plug-in points for detectors, which find objects in pictures by words."""
