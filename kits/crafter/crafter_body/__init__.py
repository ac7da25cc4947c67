"""A life in Crafter as a target of phyagentos."""
