"""A way is promoted on proof, with a bounded chance of error, and demoted when it becomes worse."""

import numpy as np
import pytest

from phyagentos.agent.memory.semantic import ALPHA, P_BAD, P_GOOD, Rank, Trial

from .conftest import SLOW, ask, make_episode

TRIALS, LONGEST = 3000, 400


def draw_rank(rng, p):
    """How a way fares that succeeds with probability p."""
    trial = Trial()
    for seed in range(LONGEST):
        if trial.rank is not Rank.TRIAL:
            break
        trial = trial.add(seed, success=rng.random() < p)
    return trial.rank


def draw_share(p, rank, seed=1):
    rng = np.random.default_rng(seed)
    return sum(draw_rank(rng, p) is rank for _ in range(TRIALS)) / TRIALS


@pytest.mark.parametrize("p", [P_BAD, 0.7, 0.5])
def test_a_way_that_is_not_good_enough_is_promoted_in_at_most_alpha_of_the_trials(p):
    assert draw_share(p, Rank.PROMOTED) <= ALPHA


def test_a_good_way_is_mostly_promoted():
    assert draw_share(P_GOOD, Rank.PROMOTED) >= 0.85
    assert draw_share(0.99, Rank.PROMOTED) >= 0.97


def test_the_same_start_proves_nothing_twice():
    trial = Trial()
    for _ in range(200):
        trial = trial.add(7, success=True)
    assert (trial.rank, trial.starts) == (Rank.TRIAL, (7,))


def test_a_promoted_way_that_becomes_bad_is_demoted_and_one_that_stays_good_is_not():
    rng = np.random.default_rng(3)
    promoted = Trial(rank=Rank.PROMOTED)
    worse = good = promoted
    for seed in range(60):
        worse = worse.add(seed, success=rng.random() < 0.5)
        good = good.add(seed, success=rng.random() < 0.99)
    assert (worse.rank, good.rank) == (Rank.DEMOTED, Rank.PROMOTED)


def test_a_way_that_was_turned_down_is_not_tried_until_it_looks_good():
    trial = Trial()
    for seed in range(3):
        trial = trial.add(seed, success=False)
    for seed in range(3, 200):
        trial = trial.add(seed, success=True)
    assert trial.rank is Rank.TURNED_DOWN


def test_a_promoted_way_is_the_default_of_its_scope_until_it_is_demoted(memory):
    memory.record([make_episode(strategy=SLOW) for _ in range(40)])
    promoted = memory.find_promoted(ask(make_episode()))
    assert promoted is not None
    assert promoted.strategy == SLOW
    assert next(fact for fact in memory.experience.list_facts() if fact.strategy).promoted
    assert memory.find_promoted(ask(make_episode(item="cube"))) is None
    memory.record([make_episode(strategy=SLOW, ok=False) for _ in range(10)])
    assert memory.find_promoted(ask(make_episode())) is None
