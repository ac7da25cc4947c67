"""Damage of a partition: what can be proved intact, what is wrong, and a repair that loses no proved record."""
