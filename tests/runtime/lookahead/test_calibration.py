"""The calibration that `python -m rollout_forecaster` prints, of every forecaster."""

import json

import pytest
from rollout_forecaster.calibration import Bin, calibrate, compute_reliability, main, render

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.calibration import Scored
from phyagentos.protocol.workspace.workspace import Workspace


@pytest.fixture
def workspace(tmp_path, monkeypatch):
    scored = {"rollouts/1": [Scored(0.9, True)] * 5 + [Scored(0.9, False)]}
    scored["bad/1"] = [Scored(0.1, each.succeeded) for each in scored["rollouts/1"]]
    monkeypatch.setattr("rollout_forecaster.calibration.collect_scored", lambda _: scored)
    workspace = Workspace.create(tmp_path / "workspace", Library.open())
    contract = workspace.runtime_contract
    contract.write_text(contract.read_text() + "\nforecasting: {least_cases: 6}\n")
    return str(workspace.root)


def test_reliability_compares_what_was_foreseen_with_what_happened_bin_by_bin():
    bins = compute_reliability([Scored(0.1, False), Scored(1.0, True), Scored(0.9, False), Scored(0.8, True)])

    assert bins == (Bin(0.0, 0.2, 1, 0.1, 0), Bin(0.8, 1.0, 3, pytest.approx(0.9), 2))


def test_each_forecaster_is_printed_beside_the_base_rate_and_says_whether_it_is_in_use(workspace, capsys):
    assert main([workspace]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "rollouts/1: Brier score 0.143, base rate 0.190, 6 cases (in use)",
        "  forecast        mean    succeeded",
        "   80 to 100 %    90 %    5/6 = 83.3 % [43.6, 97.0]",
        "bad/1: Brier score 0.677, base rate 0.190, 6 cases (excluded: worse than the base rate)",
        "  forecast        mean    succeeded",
        "    0 to  20 %    10 %    5/6 = 83.3 % [43.6, 97.0]",
    ]
    main([workspace, "--json"])
    found = json.loads(capsys.readouterr().out)
    assert [(name, each["cases"], each["is_asked"]) for name, each in found.items()] == [
        ("rollouts/1", 6, True),
        ("bad/1", 6, False),
    ]


def test_few_cases_are_said_to_be_few():
    (first, *_) = render("bad/1", calibrate([Scored(0.1, True)], 20), 20)

    assert first.endswith("1 cases (in use; 20 are enough to exclude it)")


def test_without_forecasts_or_without_a_workspace_it_fails_and_says_so(tmp_path, capsys):
    workspace = Workspace.create(tmp_path / "workspace", Library.open())

    assert main([str(workspace.root)]) == 1
    assert main([str(tmp_path / "nowhere")]) == 2
    assert "NOT_A_WORKSPACE" in capsys.readouterr().err
