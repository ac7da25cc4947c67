"""The scene that the page prints begins soundly, is seen, and runs; what cannot be seen is told with its reason."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.sessions.evidence_manifest import check_bundle
from phyagentos.protocol.sessions.looks import LookRole, read_pictures
from phyagentos.protocol.settings.sensors import read_sensors
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.runtime.models.scene_start import explain_unseen, find_start_problems

ROOT = Path(__file__).resolve().parents[2]
ROBOT = (read_target(ROOT / "robots/panda/target.yaml"), ROOT / "robots/panda")
PRINTED = re.search(r"```yaml\n(scene: desk.*?)```", (ROOT / "docs/scenes_and_faults.md").read_text(), re.DOTALL)
BLOCK = "place: {area: start, position_m: [0.0, 0.0, 0.021], yaw_rad: [-3.14159, 3.14159]}"
LID = (
    "  lid: {kind: lid, fixed: true, place: {position_m: [0.49, -0.12, 0.1]}, "
    "shapes: [{kind: box, size_m: [0.2, 0.2, 0.002]}]}\ncameras:"
)
GRAPH = """\
goal: clear
objective: Put the block into the box.
scene: desk
targets: {arm: panda}
sessions:
  block: {skill: pick_and_place, target: arm, with: {object: block, destination: box}}
accept: ["inside(block, box)"]
"""


@pytest.fixture
def write_scene(tmp_path):
    def write(old: str = "", new: str = "") -> Path:
        path = tmp_path / "scenes" / "desk.yaml"
        path.parent.mkdir(exist_ok=True)
        assert old in PRINTED[1]
        path.write_text(PRINTED[1].replace(old, new), encoding="utf-8")
        return path

    return write


@pytest.mark.sim
def test_an_object_inside_the_robot_is_told_with_the_link(write_scene):
    path = write_scene(BLOCK, "place: {position_m: [0.0, 0.0, 0.1]}")
    problems = [str(each) for each in find_start_problems(path, 0, ROBOT) if each.kind == "overlap"]
    assert "inside of 'link0', which is the robot's; expected bodies that touch at most" in problems[0]


@pytest.mark.sim
@pytest.mark.parametrize(
    ("old", "new", "name", "reason"),
    [
        (BLOCK, "place: {position_m: [-2.0, 0.0, 0.021]}", "block", "outside of the picture (overhead"),
        ("    material: box\n", "    material: desk\n", "box", "of the colour of desk behind it (overhead"),
        ("cameras:", LID, "block", "hidden by lid (overhead"),
    ],
)
def test_why_an_object_is_not_seen_is_told_with_its_place(write_scene, old, new, name, reason):
    spec, sensors = read_scene(write_scene(old, new)), read_sensors(ROOT / "protocol/sensors.yaml")
    told = explain_unseen(spec, name, 0, ROBOT, sensors)
    assert told.startswith(f"The scene starts {name} at (")
    assert reason in told


@pytest.mark.journey
def test_the_reason_why_an_object_is_not_seen_names_the_pictures_that_were_looked_at(write_scene, tmp_path):
    """Of the refused session, and of the look that went to find it: what the cameras gave, pixel by pixel."""
    graph = write_scene("cameras:", LID).parents[1] / "clear.yaml"
    graph.write_text(GRAPH, encoding="utf-8")
    command = [sys.executable, "-m", "phyagentos", "run", str(graph), "-w", str(tmp_path / "w")]
    subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    told = (tmp_path / "w" / "SESSIONS.md").read_text()
    for session in ("clear-0.block", "clear-0.block.r1"):
        (named,) = set(re.findall(rf"Looked at, in evidence/{session}: ([\w-]+\.png(?:, [\w-]+\.png)*)", told))
        assert named == ", ".join(f"look-{camera}.png" for camera in ("overhead", "left", "right", "wrist"))
        folder = tmp_path / "w" / "evidence" / session
        pictures = [(folder / name).read_bytes() for name in named.split(", ")]
        assert not check_bundle(folder), "it is sealed with them"
    assert sorted(pictures) == sorted(read_pictures(folder, LookRole.END)[1])


@pytest.mark.journey
def test_the_scene_that_the_page_prints_runs(write_scene, tmp_path):
    assert find_start_problems(write_scene()) == []
    graph = tmp_path / "goal_graphs" / "clear.yaml"
    graph.parent.mkdir()
    graph.write_text(GRAPH, encoding="utf-8")
    command = [sys.executable, "-m", "phyagentos", "run", graph, "-w", tmp_path / "w", "--no-pictures", "--json"]
    done = subprocess.run(list(map(str, command)), cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert json.loads(done.stdout)["goal"]["verdict"] == "success"
