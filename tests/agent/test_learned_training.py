"""A forecaster is learned from the bundles of workspaces: which sessions count, and what the file says of them."""

import hashlib
import sys

import pytest
from learned_forecaster import training
from learned_forecaster.model import read_model

from phyagentos.protocol.sessions.evidence_manifest import MANIFEST, Sealer
from phyagentos.protocol.sessions.session import Ended

from .conftest import Play, succeed

GRAPH = """
    goal: g
    objective: The cubes into their trays.
    scene: table
    targets: {arm: panda}
    defaults: {max_replans: 0}
    sessions:
      red: {skill: pick_and_place, target: arm, with: {object: red_cube, destination: red_tray}}
      green: {skill: pick_and_place, target: arm, with: {object: green_cube, destination: green_tray}}
      blue: {skill: pick_and_place, target: arm, with: {object: blue_cube, destination: blue_tray}}
"""


@pytest.fixture
def stage(make_stage, write_graph):
    """Eight goals of three sessions: `blue` always fails, the others succeed; one is interrupted, one left unsealed."""
    stage = make_stage(
        {
            "blue": lambda world, _: Play(world=world, ended=Ended.SKILL_FAILED),
            "green": lambda world, session: interrupt(world) if session.goal == "g-8" else succeed(world, session),
        }
    )
    start, graph = stage.runtime.world, write_graph(GRAPH)
    for seed in range(1, 9):
        stage.runtime.world = start
        stage.pursue(graph, seed=seed)
    for folder in stage.workspace.evidence.iterdir():
        if folder.name != "g-8.red":
            Sealer(stage.workspace.evidence).seal(folder)
    return stage


def interrupt(world):
    return Play(world=world, ended=Ended.CANCELLED)


def train(monkeypatch, capsys, *arguments):
    monkeypatch.setattr(sys, "argv", ["learned_forecaster", *map(str, arguments)])
    return training.main(), capsys.readouterr()


@pytest.mark.slow
def test_every_sealed_session_with_a_verdict_is_learned_from_and_named_with_its_hash(
    stage, tmp_path, monkeypatch, capsys
):
    file = tmp_path / "model.json"
    code, printed = train(monkeypatch, capsys, stage.workspace.root, "--to", file)

    model, _ = read_model(file)
    bundles = model.provenance.bundles
    assert code == 0
    assert "22 sessions, 14 succeeded" in printed.out
    assert {name.split("/")[0] for name in bundles} == {"workspace"}
    assert not {"workspace/g-8.red", "workspace/g-8.green"} & set(bundles), "unsealed, and interrupted from outside"
    manifest = stage.workspace.evidence_of("g-1.blue") / MANIFEST
    assert bundles["workspace/g-1.blue"] == hashlib.sha256(manifest.read_bytes()).hexdigest()
    assert model.provenance.validation.brier < model.provenance.validation.base_brier, "blue fails, the others do not"
    first = file.read_bytes()
    train(monkeypatch, capsys, stage.workspace.root, "--to", file)
    assert file.read_bytes() == first


def test_a_handful_of_sessions_is_too_few_and_nothing_is_written(
    make_stage, write_graph, tmp_path, monkeypatch, capsys
):
    stage = make_stage()
    stage.pursue(write_graph(GRAPH))

    code, printed = train(monkeypatch, capsys, stage.workspace.root, "--to", tmp_path / "model.json")
    assert code == 2
    assert "found 0 sessions with a verdict; expected at least 20" in printed.err
    assert not (tmp_path / "model.json").exists()
