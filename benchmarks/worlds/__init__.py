"""Rooms, tables, objects, goals and faults, drawn from seeds: the one generator of worlds that benchmarks share."""
