"""`paos scene`: a picture, what is wrong with how a scene begins, and a scene of what a run last saw."""

import json
from pathlib import Path

import pytest
import yaml
from msgspec.structs import replace
from PIL import Image

from phyagentos.assembly.project import open_library
from phyagentos.assembly.scene_start import draw_start
from phyagentos.cli.outcome import ExitCode
from phyagentos.geometry import Pose
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import Status
from phyagentos.store.views.environment import render_environment

CUBES = "tabletop/cubes_and_trays"
LYING = (0.5**0.5, 0.5**0.5, 0.0, 0.0)


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.slow
def test_a_scene_is_drawn_by_its_name_and_an_unknown_camera_is_refused(paos):
    drawn = paos("scene", "render", CUBES, "-o", "it.png")
    refused = paos("scene", "render", CUBES, "--camera", "nowhere")

    assert (drawn.code, drawn.out) == (ExitCode.GOAL_MET, "wrote it.png\n")
    assert Path("it.png").read_bytes().startswith(b"\x89PNG")
    assert refused.code == ExitCode.INVALID_INPUT
    assert "overview" in refused.err


@pytest.mark.slow
def test_a_scene_of_bodies_alone_has_a_light_and_a_camera_that_sees_them(paos):
    Path("scenes").mkdir()
    data = yaml.safe_load(open_library().get_scene(CUBES).read_text(encoding="utf-8"))
    bare = {name: value for name, value in data.items() if name not in {"cameras", "lights"}} | {"scene": "bare"}
    Path("scenes/bare.yaml").write_text(yaml.safe_dump(bare, sort_keys=False), encoding="utf-8")

    assert paos("scene", "check", "bare", "--robot", "panda").code == ExitCode.GOAL_MET
    drawn = paos("scene", "render", "bare", "--camera", "overview", "-o", "bare.png")

    assert drawn.code == ExitCode.GOAL_MET, drawn.err
    with Image.open("bare.png") as picture:
        assert len(picture.convert("RGB").getcolors(1 << 20)) > 500, "something is lit and seen"


def test_a_check_names_what_floats_what_overlaps_and_what_is_far_at_its_line(paos):
    path = open_library().get_scene(CUBES)
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    at = {"red_cube": [0.5, -0.3, 0.2], "blue_cube": [0.5, 0.0, -0.01], "green_cube": [-3.0, 0.0, 0.02]}
    for name, position_m in at.items():
        data["bodies"][name]["place"] = {"position_m": position_m}
    Path("scenes").mkdir()
    Path("scenes/bad.yaml").write_text(yaml.safe_dump(data | {"scene": "bad"}, sort_keys=False), encoding="utf-8")
    found = paos("scene", "check", "bad", "--robot", "panda", "--json")
    problems = json.loads(found.out)["problems"]

    assert found.code == ExitCode.INVALID_INPUT
    for code, name in (
        ("SCENE_INVALID", "red_cube"),
        ("SCENE_INVALID", "blue_cube"),
        ("OUT_OF_REACH", "green_cube"),
        ("OBJECT_HIDDEN", "green_cube"),
    ):
        assert [each for each in problems if each["code"] == code and name in each["found"]], (code, name)
    assert all("bad.yaml:" in each["address"] for each in problems)
    assert paos("scene", "check", CUBES, "--robot", "panda").code == ExitCode.GOAL_MET


def test_what_a_run_last_saw_becomes_a_scene_in_which_objects_begin_there(paos):
    library = open_library()
    world = draw_start(library, CUBES, ["panda"], 3)
    bottle = replace(world.entities["bottle"], pose=Pose((0.5, -0.2, 0.03), LYING))
    changed = {"bottle": bottle, "red_cube": replace(world.entities["red_cube"], status=Status.GONE)}
    space = Workspace.create(Path("w"), library)
    space.environment.write_text(
        render_environment(replace(world, entities={**world.entities, **changed})), encoding="utf-8"
    )
    saved = paos("scene", "save", "seen", "-w", "w")
    again = draw_start(open_library(), "seen", ["panda"], 8)

    assert saved.code == ExitCode.GOAL_MET
    assert "LEFT OUT red_cube: it is gone" in saved.err
    assert again.entities.keys() == world.entities.keys() - {"red_cube"}
    for name in ("blue_cube", "green_tray"):
        assert again.entities[name].pose.position_m == pytest.approx(world.entities[name].pose.position_m, abs=1e-3)
    assert again.entities["bottle"].pose.quaternion_wxyz == pytest.approx(LYING, abs=1e-3)
    assert paos("scene", "save", "seen", "-w", "w").code == ExitCode.INVALID_INPUT
    assert paos("scene", "save", "../seen", "-w", "w").code == ExitCode.INVALID_INPUT
