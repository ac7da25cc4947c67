"""Serves a game of NetHack, by the settings of BALROG."""
