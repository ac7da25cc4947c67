"""One session as MCAP: what the package mcap reads back is what the bundle and the journal hold."""

import base64
import json
import sys
import zipfile
from datetime import datetime

import jsonschema
import msgspec
import numpy as np
import pytest

from phyagentos.protocol.sessions.looks import LookEntry, LookRole, StoredFrame, StoredFrames, StoredLook, StoredRequest
from phyagentos.protocol.sessions.recording import INDEX, RECORDING, RecordedPicture, Recording
from tests.command_line import assert_refused
from tests.stored_workspace import unpack_stored

reader = pytest.importorskip("mcap.reader", reason="needs the extra `export`: pip install '.[export]'")

SESSION = "tidy_table-7.red"


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A recorded workspace; the first session's bundle has pictures of two cameras besides."""
    folder = unpack_stored(tmp_path_factory.mktemp("stored"))
    bundle = folder / "evidence" / SESSION
    pictures = tuple(
        RecordedPicture(camera="front", shown_s=shown_s, time_s=time_s, rgb=name)
        for shown_s, time_s, name in ((0.5, 0.44, "a.png"), (0.7, 0.64, "b.png"))
    )
    with zipfile.ZipFile(bundle / RECORDING, "w") as file:
        file.writestr(INDEX, msgspec.json.encode(Recording(rate_hz=5.0, pictures=pictures)))
        file.writestr("a.png", b"dark")
        file.writestr("b.png", b"light")
    shown = {"width": 4, "height": 3, "depth_m": "d.npy"}
    whole = StoredFrames(
        frames=(
            StoredFrame(camera="front", time_s=0.64, rgb="w0.png", **shown),  # the recording has it already
            StoredFrame(camera="top", time_s=0.6, rgb="w1.png", **shown),
        )
    )
    part = StoredFrames(frames=(StoredFrame(camera="top", time_s=0.8, rgb="w2.png", **shown),))
    captures = ((StoredRequest(), whole), (StoredRequest(crops={"top": (0, 0, 2, 2)}), part))
    with zipfile.ZipFile(bundle / "look-1.zip", "w") as file:
        file.writestr("look.json", msgspec.json.encode(StoredLook(phy="look/1", captures=captures)))
        file.writestr("w1.png", b"from above")
    looks = [
        LookEntry(file=file, sha256="0", role=LookRole.LOOK, time_s=0.6)
        for file in ("look-1.zip", "look-that-a-clean-up-took.zip")
    ]
    (bundle / "looks.json").write_bytes(msgspec.json.encode(looks))
    return folder


@pytest.fixture
def log(stored, tmp_path, paos):
    """The messages by topic, each with its schema, its times [ns] and its value; and the attachments."""
    file = tmp_path / "red.mcap"
    done = paos("export", "mcap", "red", "-w", stored, "--to", file)
    assert (done.code, done.out) == (0, f"wrote {file}\n"), done.err
    topics = {}
    with file.open("rb") as stream:
        opened = reader.make_reader(stream, validate_crcs=True)
        for schema, channel, message in opened.iter_messages():
            topics.setdefault(channel.topic, []).append((schema, message, json.loads(message.data)))
    with file.open("rb") as stream:
        attachments = {each.name: each for each in reader.make_reader(stream).iter_attachments()}
    return topics, attachments


def test_every_number_of_the_trajectory_is_there_as_it_was_recorded(stored, log):
    rows = [value for _, _, value in log[0]["/trajectory"]]

    with np.load(stored / "evidence" / SESSION / "trajectory.npz") as recorded:
        assert len(rows) == len(recorded["time_s"]) == 145
        for name in ("time_s", "gripper_measured_m", "gripper_commanded_m"):
            assert [row[name] for row in rows] == recorded[name].tolist()
        for name in ("q_commanded", "q_measured", "qd_measured"):
            assert [list(row[name].values()) for row in rows] == recorded[name].tolist()
            assert list(rows[0][name]) == [f"joint{number}" for number in range(1, 8)]


def test_every_change_of_the_tree_and_the_statechart_is_there_in_order(stored, log):
    trace = (stored / "evidence" / SESSION / "trace.jsonl").read_text().splitlines()
    tree = [value for _, _, value in log[0]["/tree"]]
    states = [value["state"] for _, _, value in log[0]["/session"]]

    assert [(each["path"], each["status"], each["time_s"]) for each in tree] == [
        (each["path"], each["status"], each["time_s"]) for each in map(json.loads, trace)
    ]
    assert tree[-1]["status"] == "FAILURE"
    assert states[0] == "pending"
    assert states[-1] == "replanned"
    assert "running" in states


def test_the_motion_begins_and_ends_between_the_states_that_say_so(log):
    topics, _ = log
    session = {value["state"]: message for _, message, value in topics["/session"]}
    motion = [message.log_time for _, message, _ in topics["/trajectory"]]
    times = [(message.log_time, value["time_s"]) for _, message, value in topics["/trajectory"] + topics["/tree"]]

    assert session["running"].log_time <= motion[0] < motion[-1] <= session["awaiting_verification"].log_time
    assert session["awaiting_verification"].log_time < session["replanned"].log_time
    offsets = {log_ns - round(time_s * 1e9) for log_ns, time_s in times}
    assert max(offsets) - min(offsets) <= 1  # one clock, to the nanosecond
    for _, message, value in topics["/session"]:
        assert abs(message.publish_time / 1e9 - datetime.fromisoformat(value["at"]).timestamp()) < 1e-5


def test_whole_pictures_of_recording_and_looks_are_there_once_with_their_stamps(log):
    topics, _ = log
    start_ns = topics["/tree"][0][1].log_time - round(topics["/tree"][0][2]["time_s"] * 1e9)
    found = {
        topic: [
            (
                round((message.log_time - start_ns) / 1e9, 6),
                round(value["timestamp"]["sec"] + value["timestamp"]["nsec"] / 1e9 - start_ns / 1e9, 3),
                base64.b64decode(value["data"]),
            )
            for _, message, value in messages
        ]
        for topic, messages in topics.items()
        if topic.startswith("/camera/")
    }

    assert found == {
        "/camera/front": [(0.5, 0.44, b"dark"), (0.7, 0.64, b"light")],
        "/camera/top": [(0.6, 0.6, b"from above")],
    }
    schema, _, value = topics["/camera/top"][0]
    assert (schema.name, value["frame_id"], value["format"]) == ("foxglove.CompressedImage", "top", "png")


@pytest.mark.slow
def test_every_message_fits_its_schema_and_no_number_is_missing_in_it(log):
    for messages in log[0].values():
        for schema, _, value in messages:
            form = json.loads(schema.data)
            assert schema.encoding == "jsonschema"
            jsonschema.validate(value, {key: each for key, each in form.items() if key != "title"})
            assert form["properties"].keys() <= value.keys()


def test_documents_and_the_journal_of_the_session_are_attached_byte_for_byte(stored, log):
    _, attachments = log
    bundle = stored / "evidence" / SESSION
    documents = {path.name for path in bundle.iterdir() if path.suffix in {".json", ".jsonl", ".yaml"}}

    assert documents | {"journal.md"} == attachments.keys()
    assert all(attachments[name].data == (bundle / name).read_bytes() for name in documents)
    assert attachments["contract.yaml"].media_type.startswith(("application/", "text/"))
    journal = attachments["journal.md"].data.decode()
    assert journal.count(f'- {{"id":"{SESSION}","ev":') == 6


def test_without_the_package_the_extra_is_named(stored, tmp_path, paos, monkeypatch):
    monkeypatch.setitem(sys.modules, "mcap.writer", None)

    assert_refused(
        paos("export", "mcap", "red", "-w", stored, "--to", tmp_path / "red.mcap"),
        "paos export mcap: EXTRA_MISSING",
        "pip install '.[export]'",
    )
    assert not (tmp_path / "red.mcap").exists()


def test_one_command_draws_a_tree_the_statechart_and_a_goal_as_mermaid(stored, paos):
    tree = paos("export", "mermaid", "push")
    statechart = paos("export", "mermaid", "statechart")
    goal = paos("export", "mermaid", "-w", stored)

    assert tree.out == paos("tree", "show", "push", "--mermaid").out
    assert statechart.out == paos("lifecycle", "--mermaid").out
    assert goal.out == paos("graph", "tidy_table-7", "-w", stored, "--mermaid").out
    assert [each.out.partition("\n")[0] for each in (tree, statechart, goal)] == [
        "flowchart TD",
        "stateDiagram-v2",
        "flowchart TD",
    ]
    unknown = paos("export", "mermaid", "psh", "-w", stored)
    assert (unknown.code, "UNKNOWN_NAME (goal)" in unknown.err) == (2, True)
