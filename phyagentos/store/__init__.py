"""The truth of a workspace: the append-only journal, and what is rendered from or merged into it."""
