"""An agent in ScienceWorld as a target of phyagentos."""
