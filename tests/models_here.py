"""Robots whose models are here: others are skipped, with the command that brings them."""

from pathlib import Path

import pytest

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.models.sources import require_models


def read_profile_here(name: str) -> tuple[TargetProfile, Path]:
    """A profile and its folder; skips the test where its model, or that of its hand, is not here."""
    profile, folder = read_profile(Library.open().get_target(name))
    try:
        require_models(profile, folder)
    except DefinitionError as error:
        pytest.skip(f"{error} Then run this file again.")
    return profile, folder
