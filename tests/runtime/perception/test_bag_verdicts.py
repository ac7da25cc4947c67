"""Verdicts on bags of ROS 2 that a recorder of others made: right, or unknown with the reason; no false success."""

import itertools
import shutil
import zlib

import msgspec
import numpy as np
import pytest

from phyagentos.errors import DefinitionError
from phyagentos.operations.verify_bag import verify_bag
from phyagentos.protocol.sessions.evidence import AFTER
from phyagentos.protocol.sessions.looks import read_looks, read_stored_look
from phyagentos.protocol.settings.bag import BagSettings
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.truth import Truth
from phyagentos.runtime.perception.bag_looks import explain_clock
from phyagentos.runtime.perception.bag_reader import decode_color, decode_depth, find_kind, read_bag
from tests.bags import SCENE, Recorder, Table

pytest.importorskip("rosbags", reason="needs the extra `export`: pip install '.[export]'")
pytestmark = pytest.mark.sim

RED = "inside(red_cube, red_tray)"
IN = {0.6: lambda table: table.put_into("red_cube", "red_tray")}
OUT = IN | {1.2: lambda table: table.put("red_cube", 0.45, -0.05, 0.021)}
UNTIL_S = 2.0


@pytest.fixture
def judge(tmp_path):
    """Records a run and judges it; the simulator says where the cube is at the end."""

    def judge(script, recorder=None, accept=(RED,), seed=3, level="nominal", **how):
        table = Table(seed=seed, level=level)
        bag = (recorder or Recorder(rate_hz=5.0)).record(table, tmp_path / f"bag{next(numbers)}", script, UNTIL_S)
        found = verify_bag(bag, SCENE, accept, tmp_path / f"{bag.name}_verdict", **how)
        return found, is_inside(table)

    numbers = itertools.count()
    return judge


def is_inside(table):
    x, y, z = np.abs(table.where("red_cube") - table.where("red_tray"))
    return bool(x < 0.055 and y < 0.09 and z < 0.035)


def is_lost(topic, time_s, share):
    """Whether a message is, always alike; a picture is lost with its depth."""
    return zlib.crc32(f"{topic[:4]} {time_s:.2f}".encode()) % 100 < 100 * share


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """The bag of a run that puts the cube into its tray, and whether it is there."""
    table, bag = Table(), tmp_path_factory.mktemp("inside") / "bag"
    return Recorder(rate_hz=5.0).record(table, bag, IN, UNTIL_S), is_inside(table)


@pytest.fixture(scope="module")
def shown_inside(recorded):
    """The verdict on that bag, and whether the cube is there."""
    bag, is_true = recorded
    return verify_bag(bag, SCENE, (RED,), bag.with_name("verdict")), is_true


def test_what_a_bag_shows_at_its_end_is_judged_as_the_simulator_has_it(judge, shown_inside):
    for (found, is_true), truth in ((shown_inside, True), (judge(OUT), False), (judge({}), False)):
        assert (found.verdict is Truth.TRUE, found.verdict is Truth.FALSE, is_true) == (truth, not truth, truth)
        assert (found.left_out, found.robot) == ((), "panda")


def test_the_verdict_names_its_frames_and_keeps_them(shown_inside):
    found, _ = shown_inside
    (criterion,) = found.criteria

    assert [(look.role, look.time_s) for look in found.looks] == [("start", 0.0), ("look", 1.6), ("end", 2.0)]
    assert [(each.camera, each.color, each.depth) for each in found.looks[-1].frames] == [
        (name, f"/{name}/color/image_raw", f"/{name}/depth/image_rect") for name in ("left", "overhead", "right")
    ]
    assert {each.stamp_ns for each in found.looks[-1].frames} == {1_700_000_002_000_000_000}
    assert criterion.evidence == AFTER
    assert criterion.measured["above_floor_m"] > 0.0
    after = msgspec.json.decode((found.evidence / AFTER).read_bytes(), type=Environment)
    assert after.time_s == 2.0
    for look in found.looks:
        assert all((found.evidence / f"{look.role}-{each.camera}.png").is_file() for each in look.frames)
    for entry in read_looks(found.evidence):
        assert read_stored_look(found.evidence / entry.file, entry.sha256).captures


@pytest.mark.parametrize(
    ("color", "depth", "tint", "off_m"),
    [
        ("bgr8", "32FC1", 0, 0.0), ("png", "16UC1", 0, 0.0005), ("jpeg", "16UC1", 6, 0.0005),
        ("rgba8", "16UC1/compressedDepth", 0, 0.0005), ("rgb8", "32FC1/compressedDepth", 0, 0.003),
    ],
)  # fmt: skip
def test_pictures_and_depths_of_other_encodings_are_read(tmp_path, color, depth, tint, off_m):
    """Colours but for what JPEG loses on the average; depths but for their unit."""
    table = Table()
    bag = read_bag(Recorder(color=color, depth=depth).record(table, tmp_path / "bag", {}, 0.0))
    shown = table.capture("left", 0.0, 0)
    taken = [each for topic, (each,) in bag.pictures.items() if topic.startswith("/left/") and "info" not in topic]
    found = {find_kind(each): each for each in taken}

    assert np.abs(decode_color(found["color"]).astype(int) - shown.rgb).mean() <= tint
    np.testing.assert_allclose(decode_depth(found["depth"]), shown.depth_m, atol=off_m + 1e-6)


def test_compressed_pictures_and_depths_are_found_by_their_topics(judge):
    found, _ = judge(IN, Recorder(rate_hz=5.0, color="png", depth="32FC1/compressedDepth"))
    assert found.verdict is Truth.TRUE


def test_a_lens_and_places_that_are_published_once_and_joints_of_others_are_no_trouble(judge, monkeypatch):
    monkeypatch.setattr("phyagentos.runtime.perception.bag_reader.EDGE_NS", 500_000_000)
    habits = Recorder(rate_hz=5.0, lens_once_s=1.0, static_s=1.2, extra=("lift_joint", "pan_joint"))
    found, _ = judge(IN, habits)

    assert (found.verdict, found.left_out) == (Truth.TRUE, ())


def test_rectified_pictures_have_the_projection_of_their_lens(judge):
    found, _ = judge(IN, Recorder(rate_hz=5.0, rectified=True))
    assert (found.verdict, found.left_out) == (Truth.TRUE, ())


def test_a_picture_without_bytes_is_left_out(judge, monkeypatch):
    empty = lambda *_: (True, np.zeros((0, 1), np.uint8))  # noqa: E731
    monkeypatch.setattr("tests.bags.cv2.imencode", empty)
    found, _ = judge(IN, Recorder(rate_hz=5.0, color="jpeg"))
    assert found.verdict is Truth.UNKNOWN
    assert any("encoding 'jpeg' is not read" in each for each in found.left_out)


def test_a_world_that_changed_after_the_last_picture_is_unknown(judge):
    lost = Recorder(rate_hz=5.0, drops=lambda topic, time_s: "color/image" in topic and time_s > 1.0)
    found, is_true = judge(OUT, lost)

    assert (found.verdict, is_true) == (Truth.UNKNOWN, False)
    assert "camera overhead: its last picture is 1.00 s before the end" in found.left_out
    assert found.looks == ()


def test_single_frames_that_are_lost_change_no_verdict(judge):
    lost = Recorder(rate_hz=10.0, drops=lambda topic, time_s: "image" in topic and is_lost(topic, time_s, 0.3))
    assert judge(IN, lost)[0].verdict is Truth.TRUE


def test_messages_that_took_less_time_at_the_end_hide_no_picture(judge):
    recorder = Recorder(rate_hz=1.0, late_s=lambda topic, time_s: 0.005 if time_s > UNTIL_S - 0.1 else 0.045)
    found, _ = judge(IN, recorder)

    assert found.left_out == ()


def test_one_look_does_not_show_that_an_object_rests(judge):
    late = Recorder(rate_hz=10.0, drops=lambda topic, time_s: "image" in topic and time_s < 1.9)
    found, _ = judge(IN, late)

    assert found.verdict is Truth.UNKNOWN
    assert found.criteria[0].because == "red_cube was seen once, which does not show that it rests"


def test_a_camera_of_another_clock_is_left_out(judge):
    late = Recorder(rate_hz=5.0, clock_s=dict.fromkeys(("/left/color/image_raw", "/left/depth/image_rect"), 1.0))
    found, _ = judge(IN, late)

    assert found.verdict is Truth.TRUE
    assert [each.camera for each in found.looks[-1].frames] == ["overhead", "right"]
    says = "stamps 1.00 s {} the joint states' clock; clock_s allows 0.2 s"
    assert f"camera left: {says.format('ahead of')}" in found.left_out
    assert explain_clock(1_005_000_000, 5_000_000, BagSettings()) == says.format("behind")


def test_old_pictures_with_stamps_of_now_are_not_believed(judge):
    topics = [
        f"/{name}/{each}" for name in ("left", "right", "overhead") for each in ("color/image_raw", "depth/image_rect")
    ]
    ahead = Recorder(
        rate_hz=5.0, clock_s=dict.fromkeys(topics, 0.9), drops=lambda topic, time_s: "image" in topic and time_s > 1.1
    )
    found, is_true = judge(OUT, ahead)

    assert (found.verdict, is_true) == (Truth.UNKNOWN, False)
    assert any("0.90 s ahead of" in each or "stamps 0.8" in each for each in found.left_out)


def test_without_depth_lens_or_place_of_a_camera_all_is_unknown(judge):
    def drop(part):
        return Recorder(rate_hz=5.0, drops=lambda topic, time_s: part in topic)

    for recorder, why in (
        (drop("depth"), "no depth within 0.02 s of its pictures"),
        (drop("camera_info"), "no camera_info"),
        (
            Recorder(rate_hz=5.0, tf=lambda camera, pose: None),
            "no transform leads from world to overhead_optical_frame",
        ),
        (Recorder(rate_hz=5.0, color="mono8"), "/overhead/color/image_raw: encoding 'mono8' is not read"),
        (drop("color/image"), "no topic has pictures in colour"),
        (drop("joint_states"), ""),
    ):
        found, _ = judge(IN, recorder, robot="panda")
        assert found.verdict is Truth.UNKNOWN
        assert any(why in each for each in found.left_out), found.left_out
        assert why in found.criteria[0].because


def shift(pose, *off_m):
    return msgspec.structs.replace(pose, position_m=tuple(np.add(pose.position_m, off_m).tolist()))


def test_a_camera_that_was_moved_is_not_believed(judge):
    moved = Recorder(rate_hz=5.0, tf=lambda camera, pose: shift(pose, 0.0, 0.06, 0.0) if camera == "left" else pose)
    found, _ = judge(IN, moved)

    after = msgspec.json.decode((found.evidence / AFTER).read_bytes(), type=Environment)
    assert (found.verdict, after.sensors["left"].status) == (Truth.TRUE, "displaced")
    assert "camera left: displaced, its depth disagrees with the other cameras" in found.left_out


@pytest.mark.parametrize(("seed", "off_m"), [(4, (0.0, 0.12)), (5, (0.08, 0.0))])
def test_cameras_in_another_frame_than_the_scenes_decide_nothing(judge, seed, off_m):
    """All of them say that they stand aside, and a cube beside the tray seems to be where the tray should be."""
    beside = {0.2: lambda table: table.put_into("red_cube", "red_tray", (-off_m[0], -off_m[1], 0.0))}
    found, is_true = judge(beside, Recorder(rate_hz=5.0, tf=lambda camera, pose: shift(pose, *off_m, 0.0)), seed=seed)

    assert (found.verdict, is_true) == (Truth.UNKNOWN, False)
    assert "red_tray does not show where the scene lets it be" in found.criteria[0].because


def test_a_frozen_camera_is_not_believed(judge):
    names = ("overhead", "left", "right")
    found, is_true = judge({0.0: IN[0.6]} | {1.2: OUT[1.2]}, Recorder(rate_hz=5.0, frozen=names))

    assert (found.verdict, is_true) == (Truth.UNKNOWN, False)
    after = msgspec.json.decode((found.evidence / AFTER).read_bytes(), type=Environment)
    assert {each.status for each in after.sensors.values()} == {"frozen"}


def test_pictures_without_noise_are_of_a_frozen_camera_unless_the_settings_say_so(judge, tmp_path):
    found, _ = judge(IN, level="none")
    assert found.verdict is Truth.UNKNOWN
    assert "camera left: frozen, a new stamp on the same picture" in found.left_out
    still = write(tmp_path / "bag.yaml", "noise: false\n")
    assert judge(IN, level="none", settings=still)[0].verdict is Truth.TRUE
    never_changed = {0.0: IN[0.6]}
    assert judge(never_changed, level="none", settings=still)[0].verdict is Truth.UNKNOWN


def test_an_object_between_the_fingers_may_be_held(judge):
    """The arm has brought the cube into its tray, and has not opened its fingers."""

    def hold(table):
        table.put_into("red_cube", "red_tray")
        table.reach(np.add(table.where("red_cube"), (0.0, 0.0, 0.018)), width_m=0.041)

    found, is_true = judge({0.6: hold})
    assert (found.verdict, is_true) == (Truth.UNKNOWN, True)
    why = "red_cube is between the fingers, and joint states do not tell whether it is held"
    assert found.criteria[0].because == why


@pytest.mark.parametrize("share", [0.3, 0.98])
def test_a_truncated_bag_says_so(recorded, tmp_path, share):
    bag = shutil.copytree(recorded[0], tmp_path / "bag")
    file = next(bag.glob("*.mcap"))
    file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])

    for path in (bag, file):
        with pytest.raises(DefinitionError, match=r"UNREADABLE_FILE: found .*; expected a bag"):
            verify_bag(path, SCENE, (RED,), tmp_path / "verdict")
    assert not (tmp_path / "verdict").exists()


def test_topics_names_of_joints_and_places_of_cameras_can_be_given(judge, tmp_path):
    pose = Table().capture("overhead", 0.0, 0).world_T_camera
    file = write(
        tmp_path / "bag.yaml",
        "joints: {joint1: a1, joint2: a2}\n"
        f"cameras: {{top: {{color: /overhead/color/image_raw, place: {[*pose.position_m, *pose.quaternion_wxyz]}}}}}\n",
    )
    blind = Recorder(rate_hz=5.0, tf=lambda camera, pose: None, joint_names={"joint1": "a1", "joint2": "a2"})
    found, _ = judge(IN, blind, settings=file)
    assert [each.camera for each in found.looks[-1].frames] == ["top"]
    assert found.verdict is Truth.TRUE


def test_what_the_bag_or_the_scene_lacks_is_refused_with_what_there_is(judge, recorded, tmp_path):
    typo = write(tmp_path / "bag.yaml", "cameras: {front: {color: /lft/color/image_raw}}\n")
    for accept, how, text in (
        ((RED,), {"settings": typo}, "Did you mean '/left/color/image_raw'"),
        (("inside(red_cub, red_tray)",), {}, "Did you mean 'red_cube'"),
        ((), {}, "no criterion"),
        (("measured(path_m) < 2",), {}, "INVALID|UNKNOWN|metric"),
        ((RED,), {"robot": "go2"}, "whose base moves"),
        ((RED,), {"robot": "pnda"}, "Did you mean 'panda'"),
    ):
        with pytest.raises(DefinitionError, match=text):
            verify_bag(recorded[0], SCENE, accept, tmp_path / "verdict", **how)
    with pytest.raises(DefinitionError, match="joints of no robot of the library"):
        judge({}, Recorder(rate_hz=5.0, joint_names={"joint1": "shoulder"}))


@pytest.mark.parametrize("seed", range(4))
def test_no_damage_makes_a_false_success(judge, seed):
    """The cube is put into the tray, then just beside it; frames are lost, a clock and a camera are off."""
    rng = np.random.default_rng(seed)
    off_m = rng.uniform((0.064, 0.1), (0.09, 0.14)) * [(1, 0), (0, -1), (-1, -1)][seed % 3]
    names = ("overhead", "left", "right")
    lost, end_s, odd = rng.uniform(0.0, 0.4), rng.uniform(1.5, 3.0), names[seed % 3]
    clock_s, away_m = rng.normal(0.0, 0.3), rng.normal(0.0, 0.02, 3)
    damaged = Recorder(
        rate_hz=10.0,
        drops=lambda topic, time_s: "image" in topic and (is_lost(topic, time_s, lost) or time_s > end_s),
        clock_s={f"/{odd}/color/image_raw": clock_s, f"/{odd}/depth/image_rect": clock_s},
        tf=lambda camera, pose: shift(pose, *away_m) if camera == names[seed % 2] else pose,
    )
    script = {0.0: IN[0.6], 1.0: lambda table: table.put_into("red_cube", "red_tray", (*off_m, 0.0))}
    found, is_true = judge(script, damaged)

    assert not is_true
    assert found.verdict is not Truth.TRUE
