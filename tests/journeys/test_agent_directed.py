"""An agent directs a session on the real path: it finds a hidden cube; one that only claims so ends failed."""

import pytest

from phyagentos.bench.scorers.simulator_state import is_in_tray

pytestmark = pytest.mark.journey


def test_a_procedure_finds_a_hidden_cube_and_a_liar_ends_failed(plane):
    graphs = plane.project / "goal_graphs"
    honest, liar = (plane.mission.run(graphs / f"{name}.yaml", seed=1) for name in ("scripted", "liar"))
    first, claimed = honest.sessions[0], liar.sessions[0]
    assert (honest.verdict, len(honest.sessions)) == ("success", 1), honest
    assert is_in_tray(plane.bundle(first.id), "green_cube", "green_tray")
    assert liar.verdict == "failure"
    assert (claimed.ended, claimed.verdict) == ("completed", "replan"), "what it claims is recorded and not believed"
