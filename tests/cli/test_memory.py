"""`paos memory`: what is known, where it comes from, and what shall not count any more."""

import json

import pytest

from phyagentos.agent.memory.memory import Memory
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace
from tests.agent.memory.conftest import make_correction, make_episode
from tests.command_line import assert_refused


@pytest.fixture
def remembered(tmp_path):
    """A workspace whose memory holds one lesson and one hypothesis; gives its root and the pair of sessions."""
    workspace = Workspace.create(tmp_path / "w", Library(()))
    memory = Memory(workspace.memory, clock=SystemClock(), by="test", durable=False)
    pair = make_correction()
    memory.record([*pair, *make_correction(item="tin", ok=False), make_episode(item="cube")])
    return workspace.root, pair


def find_id(paos, root):
    entries = json.loads(paos("memory", "show", "-w", root, "--json").out)["entries"]
    return next(entry["id"] for entry in entries if entry["id"].startswith("lesson-"))


def test_show_tells_what_is_in_force_and_hides_the_rest(paos, remembered):
    root, _ = remembered
    shown = paos("memory", "show", "-w", root)
    assert shown.code == 0
    assert "a child at half speed helps" in shown.out
    assert "hypothesis" not in shown.out
    assert "more with --all" in shown.err
    assert "[hypothesis" in paos("memory", "show", "-w", root, "--all").out
    assert "soap" not in paos("memory", "show", "-w", root, "cube").out


def test_why_tells_the_chain_from_the_failure_to_the_verdict(paos, remembered):
    root, (failed, corrected) = remembered
    told = paos("memory", "why", find_id(paos, root), "-w", root).out
    assert told.index(f"{failed.session}: replan GRASP_LOST") < told.index(f"{corrected.session}: success")
    assert corrected.evidence in told
    data = json.loads(paos("memory", "why", find_id(paos, root), "-w", root, "--json").out)
    assert [episode["session"] for episode in data["episodes"]] == [failed.session, corrected.session]


def test_forget_keeps_the_entry_with_the_reason(paos, remembered):
    root, _ = remembered
    id = find_id(paos, root)
    assert paos("memory", "forget", id, "-w", root, "--reason", "another soap now").code == 0
    assert id not in paos("memory", "show", "-w", root).out
    told = paos("memory", "why", id, "-w", root).out
    assert f"{id}: retracted" in told
    assert "another soap now" in told


def test_forget_asks_for_a_reason(paos, remembered):
    root, _ = remembered
    assert paos("memory", "forget", find_id(paos, root), "-w", root).code == 2


def test_an_unknown_entry_is_told_with_the_nearest_name(paos, remembered):
    root, _ = remembered
    id = find_id(paos, root)
    assert_refused(paos("memory", "why", id[:-1], "-w", root), f"Did you mean '{id}'?")
