"""Every robot that has a profile is whole: model, hand, posture, limits. Models of others come with a command."""

import pytest

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.settings.safety import read_safety
from phyagentos.runtime.motion.profile_checks import check_profile
from tests.models_here import read_profile_here

LIBRARY = Library.open()


@pytest.mark.sim
@pytest.mark.parametrize("name", LIBRARY.names_of_targets())
def test_every_profile_is_whole(name):
    path = LIBRARY.get_target(name)
    read_profile_here(name)
    beside = path.with_name("safety.yaml")
    limits = read_safety(beside if beside.is_file() else LIBRARY.roots[-1] / "protocol" / "safety.yaml")

    assert check_profile(path, limits) == []
