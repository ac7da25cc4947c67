"""One session as a bag of ROS 2: what mcap-ros2-support and rosbags read back is what the bundle holds."""

import io
import json
import sys
import zipfile

import msgspec
import numpy as np
import pytest
import yaml
from PIL import Image

from phyagentos.geometry import Pose
from phyagentos.protocol.sessions.looks import LookEntry, LookRole, StoredFrame, StoredFrames, StoredLook, StoredRequest
from tests.command_line import assert_refused
from tests.export.test_mcap_log import SESSION, log, stored  # noqa: F401 - fixtures

decoder = pytest.importorskip("mcap_ros2.reader", reason="needs the extra `export` and mcap-ros2-support")
AT = Pose((0.5, 0.1, 1.2), (0.0, 1.0, 0.0, 0.0))
AWAY = Pose((0.6, 0.1, 1.2), (0.0, 1.0, 0.0, 0.0))
DEPTH = np.array([[1.0, np.nan, 1.5, 2.0]] * 3, np.float32)
LENS = {"fx": 90.0, "fy": 91.0, "cx": 2.0, "cy": 1.5, "width": 4, "height": 3}


@pytest.fixture
def looked(stored):  # noqa: F811
    """The recorded workspace, whose session has whole looks of a camera that stands and of one that is carried."""
    bundle = stored / "evidence" / SESSION
    png = io.BytesIO()
    Image.new("RGB", (4, 3), (200, 20, 10)).save(png, "png")
    depth = io.BytesIO()
    np.save(depth, DEPTH)
    entries = []
    for time_s, place in ((0.9, AT), (1.7, AWAY)):
        frames = tuple(
            StoredFrame(camera=name, time_s=time_s, rgb="c.png", depth_m="d.npy", world_T_camera=pose, **LENS)
            for name, pose in (("deck", AT), ("hand", place))
        )
        with zipfile.ZipFile(bundle / f"look-{time_s}.zip", "w") as file:
            captures = ((StoredRequest(), StoredFrames(frames=frames)),)
            file.writestr("look.json", msgspec.json.encode(StoredLook(phy="look/1", captures=captures)))
            file.writestr("c.png", png.getvalue())
            file.writestr("d.npy", depth.getvalue())
        entries.append(LookEntry(file=f"look-{time_s}.zip", sha256="0", role=LookRole.LOOK, time_s=time_s))
    (bundle / "looks.json").write_bytes(msgspec.json.encode(entries))
    return stored


@pytest.fixture
def bag(looked, tmp_path, paos):
    folder = tmp_path / "red_bag"
    done = paos("export", "mcap", "red", "-w", looked, "--ros2", "--to", folder)
    assert (done.code, done.out) == (0, f"wrote {folder}\n"), done.err
    return folder


def read(bag):
    """The messages by topic, each with its time [ns], as the package of MCAP's own makers decodes them."""
    topics = {}
    for each in decoder.read_ros2_messages(bag / f"{bag.name}.mcap"):
        topics.setdefault(each.channel.topic, []).append((each.log_time_ns, each.ros_msg))
    return topics


def find_stamp(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def test_joints_are_there_as_they_were_recorded(looked, bag):
    topics = read(bag)
    with np.load(looked / "evidence" / SESSION / "trajectory.npz") as recorded:
        for topic, suffix in (("/joint_states", "measured"), ("/joint_commands", "commanded")):
            messages = [message for _, message in topics[topic]]
            positions = np.array([message.position for message in messages])
            assert (positions[:, :7] == recorded[f"q_{suffix}"]).all()
            assert np.allclose(positions[:, 7:].sum(axis=1), recorded[f"gripper_{suffix}_m"], atol=1e-12)
            assert all(find_stamp(message) == at_ns for at_ns, message in topics[topic])
        names = [*(f"joint{number}" for number in range(1, 8)), "left_finger_joint", "right_finger_joint"]
        assert messages[0].name == names
        speeds = np.array([message.velocity for _, message in topics["/joint_states"]])
        assert (speeds[:, :7] == recorded["qd_measured"]).all()
        assert np.isnan(speeds[:, 7:]).all()


def test_the_time_and_what_happened_are_those_of_the_json_export(bag, log):  # noqa: F811
    topics, (json_topics, _) = read(bag), log

    for topic in ("/tree", "/session"):
        assert [(at_ns, json.loads(message.data)) for at_ns, message in topics[topic]] == [
            (message.log_time, value) for _, message, value in json_topics[topic]
        ]
    assert [at_ns for at_ns, _ in topics["/joint_states"]] == [
        message.log_time for _, message, _ in json_topics["/trajectory"]
    ]


def test_pictures_depths_lenses_and_places_of_cameras_belong_together(bag):
    topics = read(bag)

    for name in ("deck", "hand"):
        pictures, depths, infos = (
            [message for _, message in topics[f"/camera/{name}/{each}"]]
            for each in ("color/image_raw/compressed", "depth/image_rect", "color/camera_info")
        )
        assert [find_stamp(each) for each in pictures] == [find_stamp(each) for each in depths]
        assert [find_stamp(each) for each in depths] == [find_stamp(each) for each in infos]
        assert {each.header.frame_id for each in (*pictures, *depths, *infos)} == {f"{name}_optical_frame"}
        assert np.asarray(Image.open(io.BytesIO(pictures[0].data)))[0, 0].tolist() == [200, 20, 10]
        found = np.frombuffer(depths[0].data, "<f4").reshape(3, 4)
        assert (depths[0].encoding, depths[0].step) == ("32FC1", 16)
        assert np.array_equal(found, DEPTH, equal_nan=True)
        assert list(infos[0].k) == [90.0, 0.0, 1.5, 0.0, 91.0, 1.0, 0.0, 0.0, 1.0]
        assert list(infos[0].p) == [90.0, 0.0, 1.5, 0.0, 0.0, 91.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    ((_, fixed),) = topics["/tf_static"]
    (deck,) = fixed.transforms
    assert (deck.header.frame_id, deck.child_frame_id) == ("world", "deck_optical_frame")
    moving = [message.transforms[0] for _, message in topics["/tf"]]
    assert [each.child_frame_id for each in moving] == ["hand_optical_frame"] * 2
    assert [each.transform.translation.x for each in moving] == [0.5, 0.6]
    assert [each.transform.rotation.x for each in moving] == [1.0, 1.0]


def test_objects_and_the_verdict_are_markers(looked, bag):
    *worlds, (verdict_ns, verdict) = read(bag)["/markers"]
    bundle = looked / "evidence" / SESSION
    recorded = [json.loads((bundle / f"environment_{each}.json").read_text()) for each in ("before", "after")]
    for (_, message), known in zip(worlds, recorded, strict=True):
        shapes = {(f"objects/{name}", number) for name, each in known["entities"].items()
                  for number, _ in enumerate(each.get("shapes", ()))}  # fmt: skip
        assert {(each.ns, each.id) for each in message.markers} == shapes
        (cube,) = (each for each in message.markers if each.ns == "objects/red_cube")
        place, size = cube.pose.position, cube.scale
        assert [place.x, place.y, place.z] == pytest.approx(known["entities"]["red_cube"]["pose"]["position_m"])
        assert [size.x, size.y, size.z] == pytest.approx([0.04] * 3)
        assert (cube.type, cube.header.frame_id, cube.color.a) == (1, "world", 1.0)
    (text,) = verdict.markers
    first, *criteria = text.text.splitlines()
    assert first == f"{SESSION}: replan"
    assert "inside(red_cube, red_tray): false" in criteria
    assert (text.type, text.color.r) == (9, pytest.approx(0.9))
    assert verdict_ns >= worlds[-1][0]


def test_the_folder_is_a_bag_as_its_metadata_says(bag):
    from rosbags.highlevel import AnyReader

    about = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    topics = read(bag)
    assert about["storage_identifier"] == "mcap"
    assert about["relative_file_paths"] == [f"{bag.name}.mcap"]
    counts = {each["topic_metadata"]["name"]: each["message_count"] for each in about["topics_with_message_count"]}
    assert counts == {topic: len(messages) for topic, messages in topics.items()}
    qos = {each["topic_metadata"]["name"]: each["topic_metadata"] for each in about["topics_with_message_count"]}
    assert "durability: 1" in qos["/tf_static"]["offered_qos_profiles"]
    with AnyReader([bag]) as reader:
        assert {each.topic: each.msgtype for each in reader.connections}["/tf_static"] == "tf2_msgs/msg/TFMessage"
        assert sum(1 for _ in reader.messages()) == about["message_count"]


def test_nothing_is_written_over_and_the_extra_is_named(looked, bag, tmp_path, paos, monkeypatch):
    assert_refused(paos("export", "mcap", "red", "-w", looked, "--ros2", "--to", bag), "WOULD_OVERWRITE")
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    assert_refused(
        paos("export", "mcap", "red", "-w", looked, "--ros2", "--to", tmp_path / "other"),
        "paos export mcap --ros2: EXTRA_MISSING",
        "pip install '.[export]'",
    )
