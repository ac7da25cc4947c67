"""A bundle is complete, loads without this package, and repeats itself bit for bit."""

import hashlib
import json
import shutil
import zipfile
from pathlib import Path

import mujoco
import numpy as np
import pytest

from phyagentos.clock import SystemClock
from phyagentos.operations.rerun import find_differences, rerun
from phyagentos.protocol.sessions import evidence
from phyagentos.protocol.sessions.evidence_manifest import MANIFEST, check_bundle, read_manifest
from phyagentos.protocol.sessions.looks import LOOKS, read_looks
from phyagentos.protocol.settings.runtime_contract import EvidenceRetention
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.retention import apply_retention
from phyagentos.testing import ManualClock

pytestmark = pytest.mark.journey

GRAPH = Path(__file__).with_name("goal.yaml")

FILES = (
    evidence.CONTRACT, evidence.SCENE_MODEL, evidence.SCENE_XML, evidence.INITIAL, evidence.TERMINAL, evidence.BEFORE,
    evidence.AFTER, evidence.TRACE, evidence.TRAJECTORY, evidence.EVENTS, evidence.HOLDS, evidence.FAULTS,
    evidence.FINGERPRINT, evidence.EXECUTION, LOOKS,
)  # fmt: skip


@pytest.fixture(scope="module")
def calm(plane):
    report = plane.run("calm-5", seed=5)
    assert report.verdict == "success", report
    return plane.bundle("calm-5.red")


def test_a_bundle_holds_every_file(calm):
    assert [name for name in FILES if not (calm / name).exists()] == []


def test_mujoco_alone_finds_the_cube_in_the_tray(calm):
    model = mujoco.MjModel.from_binary_path(str(calm / evidence.SCENE_MODEL))
    data = mujoco.MjData(model)
    with np.load(calm / evidence.TERMINAL) as terminal:
        mujoco.mj_setState(model, data, terminal["state"], int(mujoco.mjtState.mjSTATE_INTEGRATION))
        assert np.array_equal(data.qpos, terminal["qpos"])
    mujoco.mj_kinematics(model, data)
    offset = data.xpos[model.body("red_cube").id] - data.xpos[model.body("red_tray").id]
    assert np.all(np.abs(offset[:2]) < (0.055, 0.09))
    assert 0.0 < offset[2] < 0.035
    assert "red_tray" in (calm / evidence.SCENE_XML).read_text()


def test_commands_and_measurements_agree_within_the_tracking_limit(calm):
    with np.load(calm / evidence.TRAJECTORY) as trajectory:
        error = np.abs(trajectory["q_commanded"] - trajectory["q_measured"]).max()
        assert len(trajectory["time_s"]) > 100
        assert np.allclose(np.diff(trajectory["time_s"]), 0.02)
    assert error < 0.25


@pytest.fixture(scope="module")
def other(plane):
    """A session from another start, which a fault struck."""
    plane.mission.run(GRAPH, seed=6, goal="slip-6", overrides={"defaults.max_replans": "0"})
    return plane.bundle("slip-6.red")


def test_a_repetition_from_another_start_is_told_apart(calm, other):
    differences = find_differences(calm, other)

    assert any(text.startswith("terminal.npz: qpos differs") for text in differences)


def test_the_receive_log_shows_silence_after_the_end_and_no_state_write(plane, calm):
    log = plane.workspace.logs / "receive-panda.jsonl"
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    ended: set[tuple[str, int]] = set()
    commands = 0
    for before, line in zip([{}, *lines], lines, strict=False):
        claim = (line.get("session", ""), line.get("epoch", 0))
        if line["kind"] == "End":
            ended.add(claim)
        if line["kind"] in {"Command", "Halt", "Settle"} and line.get("accepted", True):
            assert claim not in ended, line
            commands += 1
        if line["kind"] == "state_write":
            assert before.get("session", "") == "" or before["kind"] == "End", (before, line)
    assert commands > 100


def test_a_session_with_a_fault_can_be_repeated_from_its_own_documents(plane, other):
    assert rerun(plane.workspace.root, other.name).differences == ()


@pytest.fixture
def copy(plane, calm, tmp_path):
    """A workspace with the bundle of the calm session, which may be changed."""
    all_bundles = plane.workspace.evidence

    def leave_out(folder, names):
        others = [name for name in names if not name.startswith("calm-5.")] if Path(folder) == all_bundles else []
        being_written = [name for name in names if name.endswith(".tmp")]  # the planes are there
        return {"sockets", "signals", *others, *being_written}

    return Workspace(shutil.copytree(plane.workspace.root, tmp_path / "copy", ignore=leave_out))


def test_a_thinned_session_can_be_repeated_and_is_compared_by_the_hashes_of_what_is_gone(copy, other):
    report = apply_retention(copy, EvidenceRetention(keep_last=0, keep_days=0), ManualClock(4e9))
    thinned = copy.evidence_of("calm-5.red")
    assert "calm-5.red" in {each.session for each in report.thinned}
    assert not (thinned / evidence.TRAJECTORY).exists()
    assert check_bundle(thinned) == []

    assert rerun(copy.root, "calm-5.red").differences == ()
    assert "trajectory.npz: differs from the hash that was kept" in find_differences(thinned, other)


def test_a_bundle_is_sealed_once_its_session_is_over(plane, calm):
    deadline = 1000
    while not (calm / MANIFEST).exists() and deadline:  # the worker seals after it has reported
        deadline -= 1
        SystemClock().sleep(0.02)

    assert check_bundle(calm) == []
    assert {name for name in FILES if name not in read_manifest(calm).files} == set()
    assert (calm / evidence.SCENE_MODEL).stat().st_nlink > 1


def test_a_verdict_is_formed_again_from_the_frames_and_a_tampered_frame_is_found(copy, calm, paos):
    verify = ("verify", "calm-5.red", "-w", copy.root, "--from-frames")
    equal = paos(*verify, "--json")
    assert equal.code == 0, equal.err
    assert json.loads(equal.out)["differences"] == []

    (end,) = (entry for entry in read_looks(calm) if entry.role == "end")
    path = copy.evidence_of("calm-5.red") / end.file
    path.unlink()
    gone = paos(*verify)
    assert gone.code > 1
    assert f"EVIDENCE_DAMAGED: no file {path}" in gone.err

    with zipfile.ZipFile(calm / end.file) as file:
        parts = {name: file.read(name) for name in file.namelist()}
    whole = max((name for name in parts if name.endswith(".png")), key=lambda name: len(parts[name]))
    for name, data in list(parts.items()):  # every camera is shown what only one of them saw
        if name.endswith(".png") and len(data) > len(parts[whole]) / 2:
            parts[name] = parts[whole]
    with zipfile.ZipFile(path, "w") as file:
        for name, data in parts.items():
            file.writestr(name, data)
    refused = paos(*verify)
    assert refused.code > 1
    assert f"EVIDENCE_DAMAGED: {path}: its bytes are not those of sha256 {end.sha256}" in refused.err

    listed = path.with_name(LOOKS)
    text = listed.read_text().replace(end.sha256, hashlib.sha256(path.read_bytes()).hexdigest())
    listed.unlink()  # perhaps shared
    listed.write_text(text)
    other = paos(*verify)
    assert other.code == 1, other.err
    assert "environment_after.json: " in other.out
