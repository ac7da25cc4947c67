"""SESSIONS.md and the inbox as inputs: each edit or request becomes records, or is refused."""
