"""Scenes are those of files here."""

import pytest


@pytest.fixture(autouse=True)
def known_scene():
    """In place of the one synthetic scene of the agent's other tests."""
