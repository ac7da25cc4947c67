"""Every goal graph that ships is met, on physics, in the shared warm plane."""

import pytest

from phyagentos.protocol.capabilities.library import find_shipped_root

pytestmark = pytest.mark.journey

GRAPHS = sorted((find_shipped_root() / "goal_graphs").glob("*.yaml"))


@pytest.mark.parametrize("graph", GRAPHS, ids=lambda path: path.stem)
def test_a_shipped_goal_graph_is_met(plane, graph):
    report = plane.mission.run(graph, seed=2)

    assert report.verdict == "success", report
    assert all(report.first_attempt_success.values()), report
    assert set(report.nodes.values()) == {"done"}


def test_a_filled_cup_keeps_every_ball_and_the_worst_tilt_is_on_record(plane):
    report = plane.mission.run(find_shipped_root() / "goal_graphs" / "carry_cup.yaml", seed=3)

    holds = [each for each in report.sessions[0].criteria if each.text == "tilt(cup) <= 0.15"]
    assert [each.truth for each in holds] == ["true"]
    assert 0.0 <= holds[0].measured["tilt_rad"] < 0.15
    assert "holds for 8" in report.criteria[-1].because
