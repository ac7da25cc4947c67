"""Lockstep: the same seed gives the same states, verdicts and bits."""

import pytest

from phyagentos.operations.rerun import find_differences

pytestmark = pytest.mark.journey


def test_two_runs_with_one_seed_are_identical_whatever_ran_before(plane, make_plane):
    first, second = plane, make_plane()
    reports = [plane.run("twin-11", seed=11) for plane in (first, second)]

    assert [each.state for each in reports[0].sessions] == [each.state for each in reports[1].sessions]
    assert reports[0].criteria == reports[1].criteria
    for session in reports[0].sessions:
        assert find_differences(first.bundle(session.id), second.bundle(session.id)) == []
