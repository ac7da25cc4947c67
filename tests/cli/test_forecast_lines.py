from phyagentos.cli.preflight import render_forecast
from phyagentos.protocol.sessions.calibration import TrackRecord
from phyagentos.protocol.sessions.lookahead import Alternative, Forecast, LookaheadResult
from phyagentos.protocol.sessions.strategy import Strategy

SLOWER = Alternative(strategy=Strategy(speed=0.5), samples=8, succeeded=8)
RISKY = LookaheadResult(
    samples=8,
    succeeded=2,
    threshold=0.8,
    causes={"GRASP_LOST": 1, "LOAD_LOST": 5},
    cost_ms=2043.2,
    alternatives=(SLOWER,),
)


def test_a_forecast_is_shown_with_chance_cause_cost_and_the_other_ways():
    assert list(render_forecast(RISKY)) == [
        "foreseen 25 % [7, 59] success: 2 of 8 rollouts, 0.8 asked; refused (2043 ms)",
        "         likely to fail of LOAD_LOST: LOAD_LOST (5), GRASP_LOST (1)",
        "         at half speed: 8 of 8",
    ]


def test_who_else_was_asked_and_who_was_not_stands_beside_the_forecast():
    learned = Forecast(forecaster="learned/1(9f86d081)", samples=40, succeeded=29.6, causes={"LOAD_LOST": 10.4})
    worse = {"hasty/1": TrackRecord(cases=31, brier=0.4, base_brier=0.2)}
    result = LookaheadResult(samples=8, succeeded=8, threshold=0.8, cost_ms=1900, others=(learned,), withheld=worse)

    assert list(render_forecast(result)) == [
        "not asked: hasty/1, Brier score 0.400, base rate 0.200, 31 cases",
        "foreseen 100 % [68, 100] success: 8 of 8 rollouts, 0.8 asked (1900 ms)",
        "         beside it 74 % [59, 85] by learned/1(9f86d081) (0 ms)",
    ]


def test_where_a_model_decides_its_cases_are_not_called_rollouts():
    causes = {"LOAD_LOST": 10.4}
    shares = {"samples": 40, "succeeded": 29.6, "threshold": 0.8, "causes": causes}
    first, *_ = render_forecast(LookaheadResult(forecaster="learned/1(9f86d081)", **shares))
    assert first.startswith("foreseen 74 % [59, 85] success: 29.6 of 40 cases foreseen by learned/1(9f86d081), 0.8")


def test_where_nobody_was_fit_to_be_asked_that_is_all_that_is_shown():
    worse = {"hasty/1": TrackRecord(cases=31, brier=0.4, base_brier=0.2)}
    nothing = LookaheadResult(samples=0, succeeded=0, threshold=0.8, withheld=worse)

    assert list(render_forecast(nothing)) == ["not asked: hasty/1, Brier score 0.400, base rate 0.200, 31 cases"]
