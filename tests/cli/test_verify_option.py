"""`paos run --verify MODE` reaches the agent that judges."""

from pathlib import Path

import pytest

from phyagentos.assembly import planes
from phyagentos.operations import run
from phyagentos.operations.run import RunRequest, start_planes
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.protocol.settings.verification_mode import VerificationMode
from phyagentos.protocol.workspace.workspace import Workspace


@pytest.mark.parametrize("mode", [None, *VerificationMode])
def test_the_agent_is_told_the_mode_that_was_asked_for(tmp_path, monkeypatch, mode):
    started = {}
    for module in (run, planes):
        monkeypatch.setattr(module, "Plane", lambda name, arguments, _logs: started.setdefault(name, arguments))
    workspace = Workspace.create(tmp_path / "w", Library(()))
    start_planes(RunRequest(graph=Path("g.yaml"), verify=mode), GoalId("g-0"), Path("g.yaml"), None, workspace)
    told = started["agent"]
    assert ("--verify" in told) == (mode is not None)
    assert mode is None or told[told.index("--verify") + 1] == mode
    assert "--verify" not in started["watch"]
