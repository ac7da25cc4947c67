"""`paos robot new`: a draft from a model, which the profile names so that it is found again."""

import json
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

from phyagentos.assembly import robot_trial
from phyagentos.assembly.robot_trial import find_band
from phyagentos.cli.outcome import ExitCode
from phyagentos.operations import robots
from phyagentos.operations.robots import RobotTrial
from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.runtime.motion.requests import Approaches
from tests.command_line import assert_ended, assert_refused
from tests.models_here import read_profile_here

MODEL = """<mujoco model="scara">
  <compiler angle="radian"/>
  <worldbody>
    <body name="upper" pos="0 0 0.2">
      <joint name="shoulder" axis="0 0 1" range="-2.5 2.5"/>
      <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.02" mass="1"/>
      <body name="lower" pos="0.25 0 0">
        <joint name="elbow" axis="0 0 1" range="-2.5 2.5"/>
        <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.015" mass="0.5"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def model(tmp_path, monkeypatch):
    (file := tmp_path / "models" / "vendor" / "scara.xml").parent.mkdir(parents=True)
    file.write_text(MODEL)
    (tmp_path / "mine").mkdir()
    monkeypatch.chdir(tmp_path / "mine")
    return file


def test_a_draft_names_its_model_below_the_folder_of_models(paos, model, monkeypatch):
    monkeypatch.setenv("PHYAGENTOS_MODELS", str(model.parents[1]))
    assert paos("robot", "new", model, "--name", "arm").code == ExitCode.GOAL_MET
    checked = paos("robot", "check", "arm")
    assert "UNREADABLE_FILE" not in checked.out
    assert "robots/arm/target.yaml" in checked.err


def test_a_file_for_ros_is_drafted_beside_a_profile_of_the_project_alone(paos, model, monkeypatch):
    monkeypatch.setenv("PHYAGENTOS_MODELS", str(model.parents[1]))
    assert_refused(paos("robot", "ros2", "panda"), "'panda', a robot of the package")
    assert paos("robot", "new", model, "--name", "arm").code == ExitCode.GOAL_MET
    drafted = paos("robot", "ros2", "arm")
    assert_ended(drafted, ExitCode.GOAL_MET, out=["ros2.yaml", "kind: trajectory"], err=["python -m ros2_body"])
    assert "shoulder: {low: -2.5, high: 2.5, axis: [0, 0, 1]" in Path("robots/arm/ros2.yaml").read_text()
    assert_refused(paos("robot", "ros2", "arm"), "WOULD_OVERWRITE")


def test_a_file_for_lerobot_is_drafted_from_what_lerobot_says(paos, model, monkeypatch):
    monkeypatch.setenv("PHYAGENTOS_MODELS", str(model.parents[1]))
    assert paos("robot", "new", model, "--name", "arm").code == ExitCode.GOAL_MET
    features = {"shoulder.pos": "float", "elbow_flex.pos": "float", "front": [48, 64, 3], "front_depth": [48, 64, 1]}
    said = {"robot": {"type": "mine", "port": "/dev/x"}, "observations": features}
    said |= {"actions": {"shoulder.pos": "float", "elbow_flex.pos": "float", "x.vel": "float"}}
    said |= {"units": {"shoulder": "degrees", "elbow_flex": "range_m100_100"}}
    (file := Path("described.yaml")).write_text(json.dumps(said))
    drafted = paos("robot", "lerobot", "arm", file)
    assert_ended(drafted, ExitCode.GOAL_MET, out=["lerobot.yaml", "check"], err=["python -m lerobot_robot"])
    text = Path("robots/arm/lerobot.yaml").read_text()
    assert ", scale: 57.2957795, zero: 0}" in text
    assert "key: elbow_flex, scale: 40, zero: 0}" in text
    assert "constants: {x.vel: 0.0}" in text
    assert "front: {color: front, depth: front_depth, focal_px: [64, 64], center_px: [32, 24]" in text
    file.write_text(json.dumps(said | {"observations": {"shoulder.pos": "float"}}))
    Path("robots/arm/lerobot.yaml").unlink()
    assert_refused(paos("robot", "lerobot", "arm", file), "found 1 positions (shoulder); expected 2, one per joint")


def test_a_robot_without_a_calibration_is_refused_by_name(paos, model, monkeypatch):
    monkeypatch.setenv("PHYAGENTOS_MODELS", str(model.parents[1]))
    assert paos("robot", "new", model, "--name", "arm").code == ExitCode.GOAL_MET
    assert_refused(paos("robot", "calibrate", "arm"), "NOT_OFFERED", "expected so101. It is no real robot.")


def test_without_that_folder_the_variable_to_set_is_named(paos, model, monkeypatch):
    monkeypatch.delenv("PHYAGENTOS_MODELS", raising=False)
    drafted = paos("robot", "new", model)
    assert f"set PHYAGENTOS_MODELS to {model.parent}" in drafted.out + drafted.err
    assert "UNREADABLE_FILE" in paos("robot", "check", "scara").out


def test_a_run_refuses_of_a_robot_of_the_project_what_its_check_refuses(paos, model, monkeypatch):
    monkeypatch.setenv("PHYAGENTOS_MODELS", str(model.parents[1]))
    assert paos("robot", "new", model, "--name", "arm").code == ExitCode.GOAL_MET
    assert paos("robot", "check", "arm").code == ExitCode.GOAL_MET
    text = (profile := Path("robots/arm/target.yaml")).read_text()
    for offered in ("joint_state", "joint_position"):  # what the goal graph asks of its arm
        text = text.replace(f"[{offered}", f"[{offered}, gripper_width")
    profile.write_text(text.replace("home_rad: [", "home_rad: [9, "))
    model.write_text(MODEL.replace('mass="1"', 'mass="0"'))
    for command in (("robot", "check", "arm"), ("run", "tidy_table", "--set", "targets.arm=arm")):
        refused = paos(*command)
        assert refused.code == ExitCode.INVALID_INPUT
        assert "target.yaml:9:3: INVALID_VALUE" in refused.out + refused.err
    model.write_text(MODEL)
    profile.write_text(re.sub(r"velocity_rad_s: \[[^,]*", "velocity_rad_s: [57", text))
    for command in (("robot", "check", "arm"), ("run", "tidy_table", "--set", "targets.arm=arm")):
        refused = paos(*command)
        assert "found 57; expected at most 1, which" in refused.out + refused.err
        assert "safety.yaml allows as joint_velocity_max. For degrees write 0.9948." in refused.out + refused.err
    model.write_text(MODEL.replace('mass="1"', 'mass="0"'))
    profile.write_text(text)
    for command in (("robot", "check", "arm"), ("robot", "render", "arm"), ("robot", "show", "arm"),
                    ("run", "tidy_table", "--set", "targets.arm=arm")):  # fmt: skip
        refused = paos(*command)
        assert refused.code == ExitCode.INVALID_INPUT
        assert "scara.xml:4: MODEL_INVALID: found link 'upper'" in refused.out + refused.err


@pytest.mark.slow
@pytest.mark.sim
def test_a_robot_is_tried_alone_before_it_is_trusted(paos, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tried = paos("robot", "try", "panda", "--to", "map.png", "--json")
    found = json.loads(tried.out)
    assert tried.code == ExitCode.GOAL_MET
    assert [each["what"] for each in found["findings"] if not each["well"]] == []
    near_m, far_m = found["band_m"]
    assert near_m < 0.34  # between these, by its profile, objects are taken from above
    assert far_m > 0.66
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.sim
def test_the_motions_of_a_trial_stay_above_the_floor_and_a_finding_names_what_decides_it(monkeypatch):
    monkeypatch.setattr(robot_trial, "CELLS", 2)
    profile, folder = read_profile_here("panda")
    low_rad = (0.0, 0.404, 0.0, -2.379, 0.0, 2.783, 0.785)  # the tool 5 cm over the floor
    low = profile.model_copy(update={"arm": profile.arm.model_copy(update={"home_rad": low_rad})})
    findings = robot_trial.run_trial(low, folder).findings
    lag = next(each for each in findings if each.what == "joints behind their set-points")
    assert lag.is_well, lag
    assert "`stiffness_nm_rad`" in lag.change


def test_what_a_trial_measures_is_written_into_the_profile_of_a_project_on_request(paos, model, monkeypatch):
    monkeypatch.setenv("PHYAGENTOS_MODELS", str(model.parents[1]))
    monkeypatch.setattr(robot_trial, "run_trial", lambda *_: robot_trial.Trial((), (0.1234, 0.4), b""))
    assert paos("robot", "new", model, "--name", "arm").code == ExitCode.GOAL_MET
    assert "robot try arm --write" in paos("robot", "try", "arm").err
    assert paos("robot", "try", "arm", "--write").code == ExitCode.GOAL_MET
    text = Path("robots/arm/target.yaml").read_text()
    assert "grasp_band_m: [0.12, 0.40]\n" in text
    assert "placement: {scale: 0.50, move_m: [0.000, 0, 0]}\n" in text
    assert paos("robot", "check", "arm").code == ExitCode.GOAL_MET
    read_profile_here("panda")
    assert_refused(paos("robot", "try", "panda", "--write"), "'panda', a robot of the package")


def test_reasons_of_planning_are_in_words():
    refused = {"ik": 5, "line": 2, "finger|cube": 9, "far": 1}
    assert robot_trial.show_reasons(refused) == "finger touches cube; out of reach; no straight line down"


def test_a_home_is_drafted_above_the_floor(paos, model, monkeypatch):
    monkeypatch.setenv("PHYAGENTOS_MODELS", str(model.parents[1]))
    pitched = MODEL.replace('"elbow" axis="0 0 1" range="-2.5', '"elbow" axis="0 1 0" range="0')
    based = pitched.replace('<body name="upper"', '<body><geom size="0.05"/><body name="upper"')
    model.write_text(based.replace("</worldbody>", "</body></worldbody>"))
    assert paos("robot", "new", model, "--name", "arm").code == ExitCode.GOAL_MET
    _, elbow_rad = yaml.safe_load(Path("robots/arm/target.yaml").read_text())["arm"]["home_rad"]
    assert elbow_rad < 1.2, "its lower arm would be in the floor"


@pytest.mark.slow
def test_a_robot_without_a_hand_is_tried_and_sent_back_for_one(paos, model, monkeypatch):
    monkeypatch.setenv("PHYAGENTOS_MODELS", str(model.parents[1]))
    drafted, tried = paos("robot", "new", model, "--name", "arm"), paos("robot", "try", "arm")
    anew = "paos robot new models:vendor/scara.xml --name arm --hand menagerie:robotiq_2f85/2f85.xml"
    assert f"it takes nothing; with one: rm -r robots/arm && {anew}" in drafted.err
    assert f"arm && {anew} --joint elbow" in tried.err
    assert_refused(paos("robot", "new", model, "--name", "arm"), "--name, or remove robots/arm to draft it anew")


@pytest.mark.parametrize(("least_m", "says"), [(0.7, "one 0.75 m over its base"), (9.0, "or another hand")])
def test_an_arm_that_takes_nothing_on_the_level_of_its_base_is_told_of_how_high_it_takes_it(monkeypatch, least_m, says):
    profile = read_profile_here("panda")[0]
    planner = SimpleNamespace(robot=SimpleNamespace(profile=profile))

    def find_grasps(_, bodies):
        return Approaches(approaches=(), timing=None) if bodies[0].pose.position_m[2] > least_m else None

    monkeypatch.setattr(robot_trial, "measure_reach", lambda _: 0.8)
    monkeypatch.setattr(robot_trial, "_find_grasps", find_grasps)
    assert says in robot_trial._advise_height(planner, 0.02)


@pytest.mark.parametrize(("takes_m", "says"), [(0.028, "at most 28 mm wide"), (0.05, "next: paos run tidy_table")])
def test_a_hand_too_small_for_the_cubes_of_the_shipped_scenes_is_said_before_a_run(paos, monkeypatch, takes_m, says):
    trial = RobotTrial(robot="a", file=Path("a"), findings=(), band_m=(0.1, 0.9), picture=Path("a.png"),
                       takes_m=takes_m, with_hand="rm")  # fmt: skip
    monkeypatch.setattr(robots, "try_robot", lambda *_, **__: trial)
    assert says in (found := paos("robot", "try", "a").err)
    assert found.count("next: ") == 1


@pytest.mark.parametrize(
    ("band_m", "placement"),
    [((0.1, 0.85), None), ((0.3, 1.0), None), ((0.1, 0.56), "{scale: 0.75, move_m: [-0.050, 0, 0]}"),
     ((0.11, 0.34), "{scale: 0.50, move_m: [-0.069, 0, 0]}")],
)  # fmt: skip
def test_scenes_come_nearer_before_they_become_smaller_than_hands(band_m, placement):
    assert robots._list_entries(*band_m).get("placement") == placement


@pytest.mark.parametrize(
    ("found", "band_m"),
    [([1, 2, 3, 4], (0.1, 0.4)), ([2, 3], (0.2, 0.3)), ([1, 3, 4], (0.3, 0.4)), ([2], None), ([], None)],
)
def test_the_band_of_grasps_has_no_gap(found, band_m):
    cells = {(k / 10, 0.0): k in found for k in (1, 2, 3, 4)} | {(-0.5, 0.0): True}
    assert find_band(cells) == (pytest.approx(band_m) if band_m else None)


def test_a_scene_of_the_project_in_which_no_object_has_a_grasp_ends_a_run_at_once(paos, tmp_path, monkeypatch):
    read_profile_here("panda")
    monkeypatch.chdir(tmp_path)
    near, far = "{area: start, position_m: [0.0, 0.0, 0.021]", "{position_m: [3.0, 0.0, 0.021]"
    for file in ("scenes/tabletop/cubes_and_trays.yaml", "goal_graphs/tidy_table.yaml"):
        (here := Path(file.split("/")[0])).mkdir()
        text = (find_shipped_root() / file).read_text().replace("tabletop/cubes_and_trays", "far")
        (here / "far.yaml").write_text(text.replace(near, far))
    refused = paos("run", "goal_graphs/far.yaml")
    assert refused.code == ExitCode.INVALID_INPUT
    assert (
        "OUT_OF_REACH: found no posture for any grasp of blue_cube, green_cube, red_cube" in refused.out + refused.err
    )


@pytest.fixture
def described(tmp_path_factory, monkeypatch):
    """Packages of the names of ROS's, of LeRobot's and of their kits, whose modules write a given file."""
    folder = tmp_path_factory.mktemp("described")
    for kit, package in (("ros2_body", "rclpy"), ("lerobot_robot", "lerobot")):
        (folder / f"{package}.py").touch()
        (folder / kit).mkdir()
        (folder / kit / "__init__.py").touch()
        (folder / kit / "description.py").write_text(
            "import pathlib, sys\nsys.argv[2] != 'gone' or sys.exit('found no robot')\n"
            "pathlib.Path(sys.argv[1]).write_text(pathlib.Path(__file__).with_name('says').read_text())\n"
        )
    monkeypatch.setenv("PYTHONPATH", str(folder))
    return folder


def test_a_running_robot_of_ros_is_written_first(paos, model, described):
    (described / "ros2_body" / "says").write_text(model.read_text())
    given = ("robot", "new", "mine.xml", "--python", sys.executable, "--from")
    assert_refused(paos(*given, "ros1"), "'ros1'", "ros2:NAMESPACE")
    assert_refused(paos(*given, "ros2:gone"), "found no robot")
    assert paos(*given, "ros2:cell").code == ExitCode.GOAL_MET
    assert Path("robots/mine/target.yaml").exists()
    assert_refused(paos("robot", "new", "a.xml", "--from", "ros2", "--python", "no_such"), "no_such", "rclpy")


def test_lerobot_describes_a_robot_first(paos, model, described, monkeypatch):
    monkeypatch.setenv("PHYAGENTOS_MODELS", str(model.parents[1]))
    assert paos("robot", "new", model, "--name", "arm").code == ExitCode.GOAL_MET
    given = ("robot", "lerobot", "arm", "described.yaml", "--python", sys.executable, "--from")
    assert_refused(paos(*given, "gone"), "found no robot")
    positions = {"shoulder.pos": "float", "elbow.pos": "float"}
    said = {"robot": {"type": "two_arm"}, "observations": positions, "actions": positions}
    (described / "lerobot_robot" / "says").write_text(json.dumps(said))
    assert paos(*given, "two_arm").code == ExitCode.GOAL_MET
    assert Path("robots/arm/lerobot.yaml").exists()
