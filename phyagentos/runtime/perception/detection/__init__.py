"""Plug-in points for detectors and segmenters that say what is in a picture by words."""
