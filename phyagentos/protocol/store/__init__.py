"""Where a workspace keeps its truth: the journal, what follows it, and signals."""
