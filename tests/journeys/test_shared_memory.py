"""A memory that outlives the run's workspace: what another workspace found out changes this one's first attempt."""

import json
from pathlib import Path

import msgspec
import pytest

from phyagentos.agent.memory.memory import Memory
from phyagentos.assembly.agent_plane import MemoryUse, open_agent
from phyagentos.clock import SystemClock
from tests.agent.memory.conftest import SLOW, make_correction

pytestmark = pytest.mark.journey

GRAPH = Path(__file__).parent / "goal.yaml"


def test_a_lesson_of_another_workspace_changes_the_session_and_task_md_names_it(plane, tmp_path, paos):
    memory = Memory(tmp_path / "memory", clock=SystemClock(), by="another workspace")
    memory.record(make_correction(thing="cube", scene="tabletop/cubes_and_trays"))
    known = set(memory.experience.corrections)

    root = plane.workspace.root
    own = sorted((root / "memory").rglob("*"))  # of what another test has done here
    with open_agent(plane.workspace, SystemClock(), by="journey", memory=tmp_path, memory_use=MemoryUse.LEARN) as agent:
        (session,) = agent.mission.run(GRAPH, seed=1, goal="advised").sessions

    task = (root / "TASK.md").read_text()
    (line,) = (line for line in task.splitlines() if line.startswith(f"- **Memory changed {session.id}:**"))
    (lesson,) = (id for id in known if id in line)
    assert f"{SLOW}: lesson {lesson}" in line
    assert sorted((root / "memory").rglob("*")) == own, "it is kept in one place"
    found = json.loads(paos("memory", "why", lesson, "-w", tmp_path, "--json").out)
    (episode,) = (each for each in found["episodes"] if each["session"] == session.id)
    assert (episode["strategy"], episode["verdict"]) == (msgspec.to_builtins(SLOW), "success")
    assert Path(episode["evidence"]).samefile(plane.workspace.evidence_of(session.id)), "found from anywhere"
