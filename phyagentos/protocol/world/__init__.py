"""Facts about the world: entities, scenes, faults, predicates."""
