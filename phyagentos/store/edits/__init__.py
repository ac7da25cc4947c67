"""SESSIONS.md as an input: what somebody wrote into it, or dropped into the inbox, becomes records or is refused."""
