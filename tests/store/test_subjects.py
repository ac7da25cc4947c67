"""What a person means by a name of a session."""

import pytest

from phyagentos.errors import DefinitionError
from phyagentos.store.subjects import get_session


def test_of_several_sessions_of_one_name_the_newest_is_told_and_no_name_is_suggested_that_was_written():
    with pytest.raises(DefinitionError) as caught:
        get_session("a", ["g-0.a", "g-0-2.a"])
    assert str(caught.value).endswith("expected g-0-2.a, g-0.a. The newest is g-0-2.a.")
    with pytest.raises(DefinitionError, match=r"Did you mean 'g-0\.red'\?"):
        get_session("g-0.rde", ["g-0.red"])
