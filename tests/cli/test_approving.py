"""`paos approve` and `paos deny`: a person or a policy decides on bytes, and only then something runs, once."""

import json
from pathlib import Path

import pytest
import yaml

from phyagentos.agent.tools.proposals import Proposal, Proposals, encode_proposal
from phyagentos.agent.tools.registry import Level
from phyagentos.assembly.memory_choice import read_choice
from phyagentos.cli.outcome import ExitCode
from phyagentos.mcp.protocol_server import build_registry
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace
from tests.command_line import assert_ended, assert_refused

ROOT = Path(__file__).resolve().parents[2]
COUNTER = ROOT / "benchmarks" / "library"
COUNT = yaml.safe_load((COUNTER / "goal_graphs" / "count.yaml").read_text(encoding="utf-8"))
POLICY = {
    "skills": ["advance"],
    "targets": ["counter"],
    "budget": {"goals_a_day": 1, "sessions": 8, "sim_time_s": 60},
}


@pytest.fixture
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(COUNTER)  # its Python is known there
    return Workspace.create(tmp_path / "w", Library.open(COUNTER))


def propose(place, graph=COUNT, decider="person", **more):
    facts = {"goal": "count", "seed": 0, "by": "mcp", "at": "2026-11-26T12:00:00.000000Z", "reason": "three"}
    proposed = encode_proposal(Proposal(decider=decider, graph=graph, **(facts | more)))
    Proposals(place.proposals).put(proposed)
    return proposed.name


def test_what_waits_is_listed_and_nothing_is_written(paos, place):
    assert paos("approve", "-w", place.root).out == "no proposal waits\n"
    name = propose(place, reason="three\nEVERYTHING IS APPROVED")
    listed = paos("approve", "-w", place.root).out
    assert listed.startswith(f"{name}  requested by mcp at")
    assert listed.count("\n") == 1
    assert not (place.proposals / "decisions").exists()


def test_nobody_who_answers_no_starts_anything(paos, place, monkeypatch):
    monkeypatch.setattr("typer.confirm", lambda *_, **__: False)
    name = propose(place)
    assert_ended(paos("approve", name, "-w", place.root), ExitCode.INTERRUPTED, err=["advance on counter"])
    assert Proposals(place.proposals).list_waiting() == [name]


def test_a_denied_proposal_cannot_be_approved(paos, place):
    name = propose(place)
    assert paos("deny", name, "-w", place.root, "--reason", "no").code == 0
    assert_refused(paos("approve", name, "-w", place.root, "--yes"), "ALREADY_OVER")
    assert paos("deny", name, "-w", place.root).code == ExitCode.INVALID_INPUT


def test_a_changed_proposal_is_not_approved(paos, place):
    name = propose(place)
    file = place.proposals / "new" / f"{name}.yaml"
    file.write_bytes(file.read_bytes().replace(b"seed: 0", b"seed: 1"))
    result = paos("approve", name, "-w", place.root, "--yes")
    assert (result.code, "CHANGED" in result.err) == (ExitCode.INVALID_INPUT, True)
    assert "CHANGED" in paos("approve", "-w", place.root).out


def test_a_goal_that_names_another_graph_is_not_approved(paos, tmp_path):
    place = Workspace.create(tmp_path / "whole", Library.open(ROOT))
    graph = {"goal": "count", "objective": "Tidy up.", "scene": "tabletop/cubes_and_trays"}
    name = propose(place, graph=graph | {"sessions": {"all": {"include": "tidy_table"}}})
    result = paos("approve", name, "-w", place.root, "--yes")
    assert (result.code, "CHANGED" in result.err) == (ExitCode.INVALID_INPUT, True)
    assert not (place.proposals / "decisions").exists()


@pytest.mark.parametrize("name", ["../../x", "count", "count-0123456789abcdef", "--"])
def test_an_unknown_or_hostile_name_is_invalid_input(paos, place, name):
    assert paos("approve", "-w", place.root, "--yes", "--", name).code == ExitCode.INVALID_INPUT


def test_a_policy_denies_with_the_reasons_and_leaves_the_rest_to_a_person(paos, place, tmp_path):
    (tmp_path / "policy.yaml").write_text(yaml.safe_dump(POLICY))
    waits, denied = propose(place), propose(place, decider="policy")
    result = paos("approve", "-w", place.root, "--policy", tmp_path / "policy.yaml", "--once-idle")
    assert result.code == 0, result.err
    proposals = Proposals(place.proposals)
    decision = proposals.find_decision(proposals.read(denied))
    assert decision.decision == "denied"
    assert "budget.sessions: NOT_PERMITTED: found None; expected at most 8" in decision.reason
    assert proposals.list_waiting() == [waits]
    assert read_ledger(place.root).goals == {}


@pytest.mark.journey
def test_an_approved_goal_runs_once_and_a_policy_permits_so_many_a_day(paos, place, tmp_path):
    name = propose(place)
    first = paos("approve", name, "-w", place.root, "--yes")
    assert (first.code, f"goal {name}: success" in first.out) == (0, True), first.err
    assert read_choice(place).folder is None, "PHYAGENTOS_MEMORY of the tests says `none`"
    sessions = set(read_ledger(place.root).sessions)
    again = paos("approve", name, "-w", place.root, "--yes")
    assert again.code == 0
    assert set(read_ledger(place.root).sessions) == sessions, "an approval is used once"

    (tmp_path / "policy.yaml").write_text(yaml.safe_dump(POLICY))
    graph = COUNT | {"budget": {"sessions": 4, "sim_time_s": 60}}
    names = [propose(place, graph=graph, decider="policy", seed=seed) for seed in (1, 2)]
    done = paos("approve", "-w", place.root, "--policy", tmp_path / "policy.yaml", "--once-idle")
    assert done.code == 0, done.err
    registry = build_registry(place.root, Level.READ)
    states = [registry.call("wait", {"id": each}).facts for each in names]
    assert [each["state"] for each in states] == ["over", "denied"]
    assert states[0]["report"].verdict == "success"
    assert "2 goals" not in json.dumps(states[1])
    assert "found 1 within a day" in states[1]["decision"]["reason"]
    assert registry.call("why", {"subject": name}).facts["explanation"]
