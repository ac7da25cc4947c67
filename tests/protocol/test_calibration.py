"""Brier score, base rate and reliability, against values computed by hand."""

import pytest

from phyagentos.protocol.sessions.calibration import Scored, TrackRecord, compute_record

FOUR = [Scored(0.9, True), Scored(0.8, True), Scored(0.3, False), Scored(0.6, True)]


def test_the_brier_score_is_the_mean_square_of_chance_minus_outcome():
    assert compute_record(FOUR).brier == pytest.approx((0.01 + 0.04 + 0.09 + 0.16) / 4)


def test_the_base_rate_foresees_each_case_from_the_others_alone():
    # a success among 2 of the 3 others: (2 + 1) / (3 + 2) = 0.6; the failure among 3 of 3: 0.8
    assert compute_record(FOUR).base_brier == pytest.approx((3 * 0.4**2 + 0.8**2) / 4)


def test_certainty_is_perfect_where_it_is_right_and_worst_where_it_is_wrong():
    right, wrong = ([Scored(chance, True)] * 20 for chance in (1.0, 0.0))

    assert (compute_record(right).brier, compute_record(wrong).brier) == (0.0, 1.0)
    assert not compute_record(right).is_unfit(20), "where all succeed, the base rate is no certainty either"
    assert compute_record(wrong).is_unfit(20)


def test_a_forecaster_is_unfit_only_when_enough_cases_say_so():
    record = TrackRecord(cases=19, brier=0.4, base_brier=0.2)

    assert [record.is_unfit(least) for least in (19, 20)] == [True, False]
    assert not TrackRecord(cases=50, brier=0.2, base_brier=0.2).is_unfit(20)
    assert str(record) == "Brier score 0.400, base rate 0.200, 19 cases"
