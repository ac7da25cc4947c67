"""Planning by effects: from a goal without a plan to a goal graph."""
