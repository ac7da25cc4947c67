from phyagentos.cli.forecasts import find_forecast, render_forecast
from phyagentos.protocol.sessions.calibration import TrackRecord
from phyagentos.protocol.sessions.evidence import write_json
from phyagentos.protocol.sessions.lookahead import LOOKAHEAD, Alternative, Forecast, LookaheadResult
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


def test_a_forecast_is_shown_with_chance_cause_cost_and_the_other_ways(tmp_path):
    write_json(tmp_path / LOOKAHEAD, RISKY)

    assert list(render_forecast(find_forecast(tmp_path))) == [
        "foreseen 25 % [7, 59] success: 2 of 8 rollouts, 0.8 asked; refused (2043 ms)",
        "         likely to fail of LOAD_LOST: LOAD_LOST (5), GRASP_LOST (1)",
        "         with speed 0.5: 8 of 8",
    ]


def test_a_forecast_as_data_has_probability_cause_and_cost(tmp_path):
    write_json(tmp_path / LOOKAHEAD, RISKY)

    found = find_forecast(tmp_path)
    assert (found["probability"], found["likely_cause"], found["cost_ms"]) == (0.25, "LOAD_LOST", 2043.2)
    assert found["alternatives"][0]["probability"] == 1.0


def test_where_no_forecast_was_made_none_is_shown(tmp_path):
    assert find_forecast(tmp_path) is None


def test_a_damaged_forecast_is_said_to_be_so_and_not_shown(tmp_path, capsys):
    (tmp_path / LOOKAHEAD).write_text("{")

    assert find_forecast(tmp_path) is None
    assert "EVIDENCE_UNREADABLE" in capsys.readouterr().err


def test_who_else_was_asked_and_who_was_not_stands_beside_the_forecast(tmp_path):
    learned = Forecast(forecaster="learned/1(9f86d081)", samples=40, succeeded=29.6, causes={"LOAD_LOST": 10.4})
    worse = {"hasty/1": TrackRecord(cases=31, brier=0.4, base_brier=0.2)}
    result = LookaheadResult(samples=8, succeeded=8, threshold=0.8, cost_ms=1900, others=(learned,), withheld=worse)
    write_json(tmp_path / LOOKAHEAD, result)

    assert list(render_forecast(find_forecast(tmp_path))) == [
        "not asked: hasty/1, Brier score 0.400, base rate 0.200, 31 cases",
        "foreseen 100 % [68, 100] success: 8 of 8 rollouts, 0.8 asked (1900 ms)",
        "         beside it 74 % [59, 85] by learned/1(9f86d081) (0 ms)",
    ]


def test_where_a_model_decides_its_cases_are_not_called_rollouts(tmp_path):
    causes = {"LOAD_LOST": 10.4}
    write_json(
        tmp_path / LOOKAHEAD,
        LookaheadResult(forecaster="learned/1(9f86d081)", samples=40, succeeded=29.6, threshold=0.8, causes=causes),
    )

    first, *_ = render_forecast(find_forecast(tmp_path))
    assert first.startswith("foreseen 74 % [59, 85] success: 29.6 of 40 cases foreseen by learned/1(9f86d081), 0.8")


def test_where_nobody_was_fit_to_be_asked_that_is_all_that_is_shown(tmp_path):
    worse = {"hasty/1": TrackRecord(cases=31, brier=0.4, base_brier=0.2)}
    write_json(tmp_path / LOOKAHEAD, LookaheadResult(samples=0, succeeded=0, threshold=0.8, withheld=worse))

    assert list(render_forecast(find_forecast(tmp_path))) == [
        "not asked: hasty/1, Brier score 0.400, base rate 0.200, 31 cases"
    ]
