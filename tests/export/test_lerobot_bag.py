"""Bags of ROS 2 as a LeRobot data set: what pyarrow and PyAV read back is what was recorded, or the bag is left out."""

import itertools
import json

import numpy as np
import pytest

from tests.bags import SCENE, Recorder, Table
from tests.command_line import assert_refused
from tests.export.test_mcap_log import SESSION, stored  # noqa: F401 - a fixture

HOW = "needs the extra `export`: pip install '.[export]'"
parquet = pytest.importorskip("pyarrow.parquet", reason=HOW)
av = pytest.importorskip("av", reason=HOW)
pytest.importorskip("rosbags", reason=HOW)
pytestmark = pytest.mark.sim

TASK = "Put the red cube into its tray"
UNTIL_S, RATE_HZ = 2.0, 5.0
IN = {0.6: lambda table: table.put_into("red_cube", "red_tray")}
AWAY = {0.95: lambda table: table.reach(np.array((0.45, 0.1, 0.3)), 0.04)}


@pytest.fixture
def export(paos, tmp_path):
    """Writes a data set of bags; its rows, its episodes, what it says of itself, and its folder."""

    def export(*bags, **options):
        folder = tmp_path / "set"
        words = [word for bag in bags for word in ("--from-bag", bag)]
        words += [word for name, value in options.items() for word in (f"--{name}", value) if word is not True]
        done = paos("export", "lerobot", *words, "--task", TASK, "--to", folder)
        assert done.code == 0, done.err
        rows = parquet.read_table(folder / "data/chunk-000/file-000.parquet").to_pydict()
        episodes = parquet.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pydict()
        return rows, episodes, json.loads((folder / "meta/info.json").read_bytes()), folder

    return export


def test_a_session_comes_back_from_its_bag_as_it_was_recorded(stored, tmp_path, paos, export):  # noqa: F811
    bag = tmp_path / "red_bag"
    assert paos("export", "mcap", "red", "-w", stored, "--ros2", "--to", bag).code == 0
    rows, episodes, info, _ = export(bag, target="panda")

    with np.load(stored / "evidence" / SESSION / "trajectory.npz") as recorded:
        time_s, measured, commanded = (recorded[name] for name in ("time_s", "q_measured", "q_commanded"))
    assert info["fps"] == round(1.0 / np.median(np.diff(time_s)))
    at = np.searchsorted(time_s, time_s[0] + np.arange(len(rows["index"]) + 1) / info["fps"] + 1e-4) - 1
    assert len(at) > 100
    assert np.abs(np.array(rows["observation.state"])[:, :7] - measured[at[:-1]]).max() < 1e-3
    assert np.abs(np.array(rows["action"])[:, :7] - commanded[at[1:]]).max() < 1e-5
    assert np.array(rows["action"])[:, 7].max() > 0.03, "the opening of the gripper"
    assert (episodes["action"], episodes["verdict"], episodes["tasks"]) == (["commanded"], [""], [[TASK]])


def test_states_and_pictures_of_a_recorder_of_others_stand_at_their_steps(tmp_path, export):
    table = Table()
    before = np.array(list(table.joints().values()))
    bag = Recorder(rate_hz=RATE_HZ, cameras=("overhead", "left")).record(table, tmp_path / "run", AWAY, UNTIL_S)
    after = np.array(list(table.joints().values()))
    rows, episodes, info, folder = export(bag, cameras="overhead,left")

    assert (info["fps"], info["robot_type"], info["total_frames"]) == (5, "panda", 10)
    state = np.array(rows["observation.state"])
    assert np.abs(state[:5, :7] - before[:7]).max() < 1e-5
    assert np.abs(state[5:, :7] - after[:7]).max() < 1e-5
    assert state[5:, 7] == pytest.approx(0.04, abs=1e-4)
    assert np.array(rows["action"])[:-1].tolist() == state[1:].tolist()
    assert episodes["action"] == ["the state one step later"]
    for name in ("overhead", "left"):
        film = folder / f"videos/observation.images.{name}/chunk-000/file-000.mp4"
        with av.open(film) as opened:
            shown = [each.to_ndarray(format="rgb24").astype(float) for each in opened.decode(video=0)]
        assert len(shown) == 10
        changes = [np.abs(a - b).mean() for a, b in itertools.pairwise(shown)]
        assert int(np.argmax(changes)) == 4, "the arm is elsewhere from the picture at 1.0 s on"


def test_a_verdict_labels_its_bag_and_a_miss_is_left_out_unless_wanted(tmp_path, paos, export, monkeypatch):
    monkeypatch.chdir(tmp_path)
    recorder = Recorder(rate_hz=RATE_HZ)
    for name, script, code in (("met", IN, 0), ("missed", {}, 1)):
        recorder.record(Table(), tmp_path / name, script, UNTIL_S)
        judged = paos("verify", "--bag", tmp_path / name, "--scene", SCENE, "--accept", "inside(red_cube, red_tray)")
        assert judged.code == code, judged.err
    _, episodes, _, folder = export(tmp_path / "met", tmp_path / "missed")
    assert episodes["verdict"] == ["success"]
    assert episodes["verdict_reason"][0].startswith("inside(red_cube, red_tray): ")
    about = json.loads((folder / "meta/phyagentos.json").read_bytes())
    assert about["episodes"] == "bags of ROS 2 that others recorded"
    assert list(about["left_out"]) == [f"{tmp_path / 'missed'}: its verdict is false"]

    folder.rename(tmp_path / "first_set")
    _, episodes, _, _ = export(tmp_path / "met", tmp_path / "missed", failures=True)
    assert episodes["verdict"] == ["success", "failure"]


@pytest.mark.parametrize(
    ("recorder", "says"),
    [
        (
            Recorder(rate_hz=RATE_HZ, drops=lambda topic, time_s: topic == "/joint_states" and 0.5 < time_s < 1.0),
            "a gap of 0.50 s in its joint states; state_s is 0.15 s",
        ),
        (
            Recorder(
                rate_hz=RATE_HZ, drops=lambda topic, time_s: "overhead/color/image" in topic and 0.3 < time_s < 1.5
            ),
            "camera overhead shows nothing new for",
        ),
        (
            Recorder(rate_hz=RATE_HZ, clock_s={"/overhead/color/image_raw": 1.0}),
            "stamps 1.00 s ahead of the joint states' clock; clock_s allows 0.2 s",
        ),
        (Recorder(rate_hz=RATE_HZ, cameras=("left",)), "no camera 'overhead'; there are left"),
    ],
)
def test_what_has_a_gap_or_another_clock_is_left_out_and_not_filled_in(recorder, says, tmp_path, paos):
    bag = recorder.record(Table(), tmp_path / "run", {}, UNTIL_S)
    options = ("--task", TASK, "--cameras", "overhead", "--to", tmp_path / "set")
    assert_refused(
        paos("export", "lerobot", "--from-bag", bag, *options), f"--from-bag: INVALID_VALUE: found {bag}: ", says
    )
    assert not (tmp_path / "set").exists()


def test_sessions_and_bags_are_not_mixed_and_a_bag_needs_its_task(tmp_path, paos):
    to = ("--to", tmp_path / "set")
    for words in (("W", "--from-bag", "B", "--task", TASK), ("--from-bag", "B"), (), ("W", "--task", TASK)):
        assert_refused(paos("export", "lerobot", *words, *to), "expected workspaces, or --from-bag with --task")
    words = ("--from-bag", "B", "--task", TASK, "--skill", "pick")
    assert_refused(
        paos("export", "lerobot", *words, *to), "--from-bag: INVALID_VALUE: found options of sessions besides"
    )
