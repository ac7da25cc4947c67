"""`paos verify --bag`: what it prints of a verdict, how it ends, and how it refuses what no bag can decide."""

import json
import re
from pathlib import Path

import pytest

from phyagentos.cli.outcome import ExitCode
from phyagentos.protocol.settings.bag import BagSettings, read_bag_settings
from tests.bags import SCENE, Recorder, Table
from tests.command_line import assert_ended, assert_refused

pytest.importorskip("rosbags", reason="needs the extra `export`: pip install '.[export]'")
RED = "inside(red_cube, red_tray)"


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """A run of half a second, at whose end the cube is in its tray."""
    script = {0.0: lambda table: table.put_into("red_cube", "red_tray")}
    return Recorder().record(Table(), tmp_path_factory.mktemp("recorded") / "run", script, until_s=0.6)


@pytest.mark.sim
def test_the_verdict_its_frames_and_what_was_left_out_are_printed(bag, paos, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = ("verify", "--bag", bag, "--scene", SCENE, "--accept", RED)
    (tmp_path / "bag.yaml").write_text("cameras: {top: {color: /overhead/color/image_raw}}", encoding="utf-8")
    found = paos(*given, "--settings", "bag.yaml")

    assert_ended(
        found,
        ExitCode.GOAL_MET,
        out=(
            f"{bag}: true, by panda in {SCENE}",
            f"  true: accept {RED}: red_cube is inside red_tray",
            "  end at 0.60 s: top (/overhead/color/image_raw, stamp 1700000000600000000)",
        ),
        err=("looks, pictures and verdict in run_verdict",),
    )
    missed = paos(*given, "--accept", "inside(blue_cube, blue_tray)", "--to", "other", "--json")
    assert missed.code == ExitCode.GOAL_NOT_MET
    assert json.loads(missed.out) == json.loads((tmp_path / "other" / "verdict.json").read_bytes())
    assert_refused(paos(*given), "run_verdict: WOULD_OVERWRITE")


def test_what_no_bag_can_decide_is_refused(paos, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    of_scene = ("--scene", SCENE, "--accept", RED)
    assert_refused(paos("verify", "--bag", "run", "--accept", RED), "UNKNOWN_NAME (scene): found ''")
    assert_refused(paos("verify", "--bag", "run", "--scene", SCENE), "--accept: MISSING_VALUE")
    assert_refused(paos("verify", "red", "--bag", "run", *of_scene), "--bag: INVALID_VALUE")
    assert_refused(paos("verify", "red", *of_scene), "--bag: MISSING_VALUE")
    assert_refused(paos("verify"), "paos verify: MISSING_VALUE: found no session")
    assert_refused(paos("verify", "--bag", "run", *of_scene), "run: UNREADABLE_FILE", "a bag of ROS 2")


def test_the_settings_on_the_page_are_valid(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "howto" / "bags.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    (tmp_path / "bag.yaml").write_text(block, encoding="utf-8")

    given, untouched = read_bag_settings(tmp_path / "bag.yaml"), BagSettings()
    assert {name for name, value in given if value != getattr(untouched, name)} == {
        "world", "joint_states", "joints", "noise", "cameras",
    }  # fmt: skip
    assert (given.clock_s, given.max_age_s) == (untouched.clock_s, untouched.max_age_s)
