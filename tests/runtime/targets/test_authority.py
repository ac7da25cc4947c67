"""Who may command a target, as the target itself remembers it."""

import pytest

from phyagentos.runtime.targets.authority import Authority


@pytest.fixture
def authority():
    authority = Authority()
    authority.begin("s", 3)
    authority.end()
    return authority


@pytest.mark.parametrize("epoch", [2, 3])
def test_no_epoch_is_granted_again_and_none_before_it(authority, epoch):
    refused = authority.check_begin("s", epoch)

    assert (refused.code, refused.message) == (
        "STALE_TOKEN",
        f"epoch {epoch} of s is over; 4 is the least that is granted",
    )


def test_the_next_epoch_is_granted_and_so_is_any_of_another_session(authority):
    assert authority.check_begin("t", 0) is None
    authority.begin("t", 0)
    authority.end()
    assert authority.check_begin("s", 4) is None


def test_an_epoch_below_all_is_refused_to_a_session_that_never_began(authority):
    assert authority.check_begin("t", -1).code == "STALE_TOKEN"


def test_the_same_claim_made_twice_does_not_undo_a_stop(authority):
    authority.begin("s", 4)
    authority.stop("ESTOPPED")

    assert authority.check_begin("s", 4) is None
    authority.begin("s", 4)
    assert authority.check_commanding("s", 4).code == "ESTOPPED"
