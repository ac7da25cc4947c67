import numpy as np
import pytest
from rollout_forecaster.playback import is_decided


def run_test(outcomes, threshold, batch=2):
    seen = []
    while not seen or not is_decided(sum(seen), len(seen), threshold, len(outcomes)):
        seen += outcomes[len(seen) : len(seen) + batch].tolist()
    return sum(seen) >= threshold * len(seen), len(seen)


@pytest.mark.parametrize(
    ("successes", "trials", "decided"),
    [(4, 4, False), (6, 6, True), (0, 2, True), (2, 4, False), (1, 4, True), (11, 12, True), (13, 16, True)],
)
def test_clear_cases_are_decided_early_and_close_ones_late(successes, trials, decided):
    assert is_decided(successes, trials, 0.8, 16) is decided


@pytest.mark.parametrize("threshold", [0.0, 0.5, 0.7, 0.8, 0.95, 1.0])
def test_it_ends_with_the_rollouts_that_were_asked_for(threshold):
    for successes in range(17):
        assert is_decided(successes, 16, threshold, 16)


def test_what_is_tried_in_any_case_is_decided_at_once():
    assert is_decided(0, 1, 0.0, 16)


def test_when_all_must_succeed_one_failure_decides_and_nothing_else_does():
    assert is_decided(3, 4, 1.0, 16)
    assert not is_decided(12, 12, 1.0, 16)


def test_no_more_is_played_than_can_change_the_share_of_all():
    assert is_decided(8, 12, 0.8, 16)


@pytest.mark.parametrize("threshold", [0.5, 0.7, 0.8])
def test_it_errs_seldom_where_the_chance_is_clear_and_takes_half_of_the_rollouts(threshold):
    rng = np.random.default_rng(3)
    for chance, is_enough in ((threshold - 0.3, False), (min(0.98, threshold + 0.2), True)):
        ends = [run_test(rng.random(32) < chance, threshold) for _ in range(400)]
        assert np.mean([found is is_enough for found, _ in ends]) >= 0.9
        assert np.mean([count for _, count in ends]) <= 16
