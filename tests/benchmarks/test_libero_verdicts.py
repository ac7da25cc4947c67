"""Figures of verdicts against hidden labels: what counts as which error, and intervals that know of episodes."""

import json
import math

import numpy as np
import pytest

from benchmarks.libero_parts.verdict_figures import (
    ASKED,
    Case,
    balance,
    bootstrap,
    compute_figures,
    read_case,
    read_run,
    share,
)
from benchmarks.libero_verdicts import append, read_results
from benchmarks.runner import finish


def case(success, said, episode=0, kind="met"):
    return Case(("suite", 0, episode), kind, success, said, at_end=success)


def is_wrong(each):
    return each.is_wrong


def test_an_abstention_is_neither_error_and_counted_apart():
    cases = [case(True, "success"), case(True, "failure"), case(True, "unknown"), case(False, "unknown")]
    cases += [case(False, "success"), case(False, "failure"), case(False, "failure")]

    found = compute_figures(cases, seed=1)

    assert found["false_successes"] == 1
    assert found["false_failures"] == 1
    assert found["false_failure_rate"] == 1 / 2, "of the successes that were decided"
    assert found["abstained_of_successes"] == found["abstained_of_failures"] == 1
    assert found["balanced_accuracy"] == pytest.approx((1 / 3 + 3 / 4) / 2), "an abstention tells no success"
    assert found["balanced_accuracy_decided"] == pytest.approx((1 / 2 + 2 / 3) / 2)


def test_who_always_says_the_same_balances_to_a_half():
    cases = [case(True, "success")] * 3 + [case(False, "failure")] * 17

    found = compute_figures(cases, seed=1)

    assert found["balanced_accuracy"] == 1.0
    assert found["balanced_accuracy_always_yes"] == found["balanced_accuracy_always_no"] == 0.5
    assert math.isnan(balance([case(True, "success")])), "there is no failure to be told"


def test_cases_of_one_episode_widen_the_interval_as_they_agree():
    apart = [case(False, "success" if number < 20 else "failure", episode=number) for number in range(100)]
    together = [case(False, "success" if number < 20 else "failure", episode=number // 10) for number in range(100)]

    alone, clustered = share(apart, is_wrong, seed=3), share(together, is_wrong, seed=3)

    assert alone.value == clustered.value == 0.2
    assert alone.low <= 0.2 <= alone.high
    assert alone.high - alone.low == pytest.approx(2 * 1.96 * math.sqrt(0.2 * 0.8 / 100), rel=0.1)
    assert clustered.high - clustered.low > 2.5 * (alone.high - alone.low)


def test_the_bootstrap_repeats_with_its_seed():
    counts = np.array([[1, 4], [0, 5], [3, 3], [0, 2]])

    first, again, other = (bootstrap(counts, np.random.default_rng(seed)) for seed in (5, 5, 6))

    assert first == again
    assert 0.0 <= first[0] <= 4 / 14 <= first[1] <= 1.0
    assert other[0] == pytest.approx(first[0], abs=0.05)


def test_nothing_wrong_is_bounded_by_three_over_the_episodes_not_the_cases():
    cases = [case(False, "failure", episode=number % 30) for number in range(600)]

    found = share(cases, is_wrong, seed=1)

    assert (found.count, found.low) == (0, 0.0)
    assert found.high == 3 / 30
    assert str(found) == "0/600 = 0.00 % [0.00, 10.00]"
    assert str(share([], is_wrong, seed=1)) == "-"


def test_the_end_of_a_run_is_a_case_of_the_same_episode():
    run = {"suite": "s", "task": 2, "state": 3, "verdict": "failure", "success": True, "reason": "why"}

    found = read_run(run)

    assert found == Case(("s", 2, 3), "end of a run", success=True, said="failure", why=("why",), at_end=True)
    assert found.is_wrong
    assert not read_run(run | {"verdict": "untranslated"}).is_wrong, "no verdict was given"


def test_an_episode_that_a_kill_cut_off_is_run_again(tmp_path):
    path = tmp_path / "results.jsonl"
    record = {"suite": "s", "task": 0, "kind": "met", "success": True, "said": "success"}
    for state in (0, 1):
        append(path, [record | {"state": state, "number": number} for number in range(3)])
    whole = path.read_text()
    path.write_text(whole[: whole.rindex("\n", 0, -1) + 20])

    assert list(read_results(path)) == [("s", 0, 0)]
    append(path, [record | {"state": 1, "number": number} for number in range(3)])
    assert [len(each) for each in read_results(path).values()] == [3, 3], "the cases of the cut episode count once"


def test_an_answer_that_is_none_is_refused():
    with pytest.raises(ValueError, match="perhaps"):
        read_case({"suite": "s", "task": 0, "state": 0, "kind": "met", "success": True, "said": "perhaps"})


def test_a_label_that_held_at_a_step_of_the_look_and_not_at_the_last_is_told_apart():
    record = {"suite": "s", "task": 0, "state": 0, "kind": "met", "success": True, "said": "success"}
    cases = [read_case(record | {"at_end": False}), read_case(record | {"at_end": True}), case(False, "failure")]

    found = compute_figures(cases, seed=1)

    assert (found["false_successes"], found["false_successes_at_end"], found["labels_that_flicker"]) == (0, 1, 1)


@pytest.mark.parametrize(("said", "holds"), [("failure", True), ("success", False)])
def test_one_false_success_among_a_thousand_fails_the_benchmark(said, holds, capsys):
    cases = [case(False, "failure", episode=number % 300) for number in range(999)] + [case(False, said)]
    cases += [case(True, "success", episode=number % 300) for number in range(1000)]

    code = finish(compute_figures(cases, seed=1) | {"missing": 0.0}, ASKED)

    assert code == (0 if holds else 1)
    assert json.loads(capsys.readouterr().out)["holds"] is holds
