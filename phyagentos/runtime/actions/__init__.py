"""The way of a command from a skill to a target, in the order it travels."""
