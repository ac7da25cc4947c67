"""Take what is nearest first: one leaf, one tree, one skill."""
