"""The composition root: builds processes from a workspace. Nothing else calls concrete constructors."""
