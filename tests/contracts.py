"""Contracts of sessions, of which a test names only the fields that it is about."""

from typing import Any

from phyagentos.protocol.sessions.session import Scene, Session


def make_contract(**facts: Any) -> Session:
    """A session; any field can be given, and those that nobody gives mean nothing."""
    others = {
        "id": "g.a",
        "goal": "g",
        "node": "a",
        "objective": "o",
        "skill": "pick_and_place",
        "target": "panda",
        "parameters": {},
        "accept": (),
        "scene": Scene(name="s", seed=0, episode="e"),
        "seed": 0,
    }
    return Session(**(others | facts))
