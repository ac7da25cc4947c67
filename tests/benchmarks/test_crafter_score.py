"""The score of lives in Crafter, without the game."""

import json

import pytest

from benchmarks.crafter import ACHIEVEMENTS, compare, compute_score, compute_sign_test, read_lives, sum_up


def test_the_score_is_a_geometric_mean_that_rare_achievements_raise_most():
    assert compute_score([ACHIEVEMENTS, ACHIEVEMENTS]) == pytest.approx(100.0)
    assert compute_score([()]) == 0.0
    half = [ACHIEVEMENTS, ()]
    assert compute_score(half) == pytest.approx(50.0)
    assert compute_score([ACHIEVEMENTS[:11], ACHIEVEMENTS[:11]]) == pytest.approx(101.0**0.5 - 1.0)


def test_a_life_counts_as_it_stood_at_its_end(tmp_path):
    lines = [
        {"seed": 1, "completed": [], "steps": 3, "is_dead": False, "cause": ""},
        {"seed": 1, "completed": ["collect_wood"], "steps": 600, "is_dead": True, "cause": "zombie"},
        {"seed": 2, "completed": ["collect_wood"], "steps": 300, "is_dead": False, "cause": ""},
    ]
    (tmp_path / "lives.jsonl").write_text("".join(json.dumps(each) + "\n" for each in lines))
    figures = sum_up(read_lives(tmp_path / "lives.jsonl"))
    assert (figures["lives"], figures["achievements_mean"], figures["days_mean"]) == (2, 1.0, 1.5)
    assert figures["died_of_zombie"] == 1
    assert figures["share_collect_wood"] == 1.0


def test_pairs_are_compared_by_what_memory_warned_of_and_by_days(tmp_path):
    def live(seed, arm, lost_to, steps, warned=("zombie",)):
        return {"seed": seed, "arm": arm, "lost_to": lost_to, "steps": steps, "warned": warned, "completed": []}

    lines = [live(1, "kept", "zombie", 300, ()), live(1, "erased", "zombie", 300, ())]
    for seed in range(2, 7):
        lines += [live(seed, "kept", "hunger", 900), live(seed, "erased", "zombie", 300)]
    lines += [live(7, "kept", "zombie", 900), live(7, "erased", "zombie", 300)]
    file = tmp_path / "pairs.jsonl"
    file.write_text("".join(json.dumps(each) + "\n" for each in [*lines, live(9, "kept", "zombie", 1)]))
    figures = compare(file)
    assert (figures["pairs"], figures["kept_deaths_warned_of"], figures["erased_deaths_warned_of"]) == (7, 0, 6)
    assert figures["deaths_p"] == figures["days_p"] == pytest.approx(0.5**6, abs=1e-4)
    assert compute_sign_test(0, 0) == 1.0
