"""Compatibility preflight: everything that can be known before a motor moves."""
