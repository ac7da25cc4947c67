"""Games of NetHack: a library with the target, its skills and the goal."""
