"""Every robot that has a profile is whole: model, hand, posture, limits. Models of others come with a command."""

import pytest

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.settings.safety import read_safety
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.models.sources import find_model
from phyagentos.runtime.motion.profile_checks import check_profile

LIBRARY = Library.open()


@pytest.mark.sim
@pytest.mark.parametrize("name", LIBRARY.names_of_targets())
def test_every_profile_is_whole(name):
    path = LIBRARY.get_target(name)
    profile, folder = read_profile(path)
    try:
        for model in [profile.model] + ([profile.hand.model] if profile.hand is not None else []):
            find_model(model, folder)
    except DefinitionError as error:
        pytest.skip(f"{error} Then: pytest tests/conformance/test_profiles.py")
    beside = path.with_name("safety.yaml")
    limits = read_safety(beside if beside.is_file() else LIBRARY.roots[-1] / "protocol" / "safety.yaml")

    assert check_profile(path, limits) == []
