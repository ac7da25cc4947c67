"""Rerun's own readers on what is exported: a session as its recording, and a session as MCAP.

Needs the extra `rerun` in this Python.
"""

import json
import tarfile
from pathlib import Path

import mujoco
import numpy as np
import pytest

from phyagentos.export.mcap_log import write_mcap
from phyagentos.export.rerun_view import TIMELINE, write_rrd
from phyagentos.pictures.playback import Playback
from phyagentos.protocol.sessions.evidence import read_bundle
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.history import fold_partition
from phyagentos.store.journal import choose_partition

pytestmark = pytest.mark.extras
ARCHIVE = Path(__file__).parents[1] / "cli" / "stored" / "tidy_table_0_1_0.tar.xz"
SESSION = "tidy_table-7.red"
SCENE = """
<mujoco>
  <asset>
    <mesh name="wedge" vertex="0 0 0  0.2 0 0  0 0.1 0  0 0 0.1"/>
    <material name="green" rgba="0 1 0 1"/>
  </asset>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 0.1"/>
    <body name="arm/1" pos="0 0 1">
      <joint type="hinge" axis="0 0 1"/>
      <geom type="capsule" size="0.1 0.3" pos="0.5 0 0" euler="0 90 0" rgba="1 0 0 1"/>
      <geom type="cylinder" size="0.1 0.3" group="3"/>
      <body pos="1 0 0">
        <geom type="cylinder" size="0.05 0.2" material="green"/>
        <geom type="mesh" mesh="wedge"/>
      </body>
    </body>
    <body name="ball">
      <freejoint/>
      <geom type="sphere" size="0.05"/>
      <geom type="box" size="0.1 0.2 0.3"/>
      <geom type="ellipsoid" size="0.1 0.2 0.3"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def rerun():
    return pytest.importorskip("rerun", reason="needs the extra `rerun`: make test-extras")


@pytest.fixture
def recorded(tmp_path):
    """A workspace, and a session of it with its verdict."""
    with tarfile.open(ARCHIVE) as archive:
        archive.extractall(tmp_path, filter="data")
    workspace = Workspace.open(tmp_path / "tidy_table")
    return workspace, fold_partition(workspace.sessions / choose_partition(workspace.sessions)).sessions[SESSION]


@pytest.fixture
def playback(recorded):
    workspace, status = recorded
    model = mujoco.MjModel.from_xml_string(SCENE)
    turns = np.linspace(0.0, 1.5, 4)
    qpos = np.array([(turn, turn, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0) for turn in turns])
    return Playback(
        model=model,
        time_s=0.4 + turns,
        qpos=qpos,
        measured_m=np.zeros((0, 3)),
        planned_m=np.zeros((0, 3)),
        bundle=read_bundle(workspace.evidence_of(SESSION), status.contract, status.execution),
    )


@pytest.fixture
def chunks(rerun, recorded, playback, tmp_path):
    """Entity -> column -> values, as Rerun reads them; static ones apart."""
    write_rrd(playback, recorded[1], tmp_path / "red.rrd")
    found = {}
    for chunk in rerun.chunk.RrdReader(str(tmp_path / "red.rrd")).stream():
        batch = chunk.to_record_batch()
        columns = found.setdefault((chunk.entity_path, chunk.is_static), {})
        for name in batch.schema.names:
            if name not in {"rerun.controls.RowId", "log_time"}:
                columns.setdefault(name, []).extend(batch.column(name).to_pylist())
    return found


def test_every_body_is_where_the_evidence_has_it_at_every_moment(playback, chunks):
    for body, path in ((1, r"/world/arm\/1"), (2, "/world/2"), (3, "/world/ball")):
        columns = chunks[path, False]
        assert [each.total_seconds() for each in columns[TIMELINE]] == pytest.approx(playback.time_s)
        for row, time_s in enumerate(playback.time_s):
            data = playback.pose(time_s)
            x, y, z, w = columns["Transform3D:quaternion"][row][0]
            assert columns["Transform3D:translation"][row][0] == pytest.approx(data.xpos[body], abs=1e-6)
            assert (w, x, y, z) == pytest.approx(data.xquat[body], abs=1e-6)


def test_each_shape_has_its_size_its_place_on_its_body_and_its_colour(playback, chunks):
    shapes = {path: columns for (path, is_static), columns in chunks.items() if is_static}
    model = playback.model
    (capsule,) = [number for number in range(model.ngeom) if model.geom_rgba[number].tolist() == [1, 0, 0, 1]]

    red = shapes[rf"/world/arm\/1/{capsule}"]
    assert red["Capsules3D:lengths"][0] == pytest.approx([0.6])
    assert red["Capsules3D:radii"][0] == pytest.approx([0.1])
    assert red["Capsules3D:translations"][0][0] == pytest.approx([0.0, 0.0, -0.3])
    assert red["Capsules3D:colors"][0] == [0xFF0000FF]
    assert red["Transform3D:translation"][0][0] == pytest.approx([0.5, 0.0, 0.0])
    x, y, z, w = red["Transform3D:quaternion"][0][0]
    assert (w, x, y, z) == pytest.approx(model.geom_quat[capsule], abs=1e-6)
    of = {name: columns for columns in shapes.values() for name in columns}
    assert of["Cylinders3D:lengths"]["Cylinders3D:lengths"] == [pytest.approx([0.4])]
    assert of["Cylinders3D:colors"]["Cylinders3D:colors"] == [[0x00FF00FF]]
    assert len(of["Mesh3D:vertex_positions"]["Mesh3D:vertex_positions"][0]) == 4
    assert len(of["Mesh3D:triangle_indices"]["Mesh3D:triangle_indices"][0]) == 4
    assert of["Boxes3D:half_sizes"]["Boxes3D:half_sizes"][0][0] == pytest.approx([0.1, 0.2, 0.3])
    rounds = [
        columns["Ellipsoids3D:half_sizes"][0][0] for columns in shapes.values() if "Ellipsoids3D:colors" in columns
    ]
    assert sorted(rounds) == [pytest.approx([0.05, 0.05, 0.05]), pytest.approx([0.1, 0.2, 0.3])]


def test_the_tree_and_the_criteria_are_text_logs(recorded, playback, chunks):
    tree = [text for (text,) in chunks["/tree", False]["TextLog:text"]]
    criteria = [text for (text,) in chunks["/criteria", False]["TextLog:text"]]

    assert [text.split()[:2] for text in tree] == [[each.path, each.status] for each in playback.bundle.trace]
    (failed,) = [text for text in tree if "GRASP_LOST" in text]
    assert failed.startswith("pick_and_place/place/carry FAILURE")
    levels = [level for (level,) in chunks["/tree", False]["TextLog:level"]]
    assert [level == "WARN" for level in levels] == [each.status == "FAILURE" for each in playback.bundle.trace]
    judged = [each for attempt in recorded[1].attempts for each in attempt.criteria]
    assert [text.partition(": ")[0] for text in criteria] == [str(each.truth) for each in judged]
    assert any("accept inside(red_cube, red_tray)" in text for text in criteria)


def test_rerun_reads_every_message_and_document_of_a_session_as_mcap(rerun, recorded, tmp_path):
    workspace, status = recorded
    write_mcap(workspace, status, tmp_path / "red.mcap")

    opened = rerun.chunk.McapReader(str(tmp_path / "red.mcap"))

    rows = {chunk.entity_path: 0 for chunk in opened.stream()}
    values = []
    for chunk in opened.stream():
        if chunk.timeline_names:
            rows[chunk.entity_path] += chunk.num_rows
        if chunk.entity_path == "/trajectory" and chunk.timeline_names:
            values += [
                json.loads(bytes(each[0])) for each in chunk.to_record_batch().column("McapMessage:data").to_pylist()
            ]
    assert (rows["/trajectory"], rows["/tree"], rows["/session"]) == (145, 25, 6)
    with np.load(workspace.evidence_of(SESSION) / "trajectory.npz") as trajectory:
        assert [each["time_s"] for each in values] == trajectory["time_s"].tolist()
    documents = [path for path in workspace.evidence_of(SESSION).iterdir() if path.suffix not in {".npz", ".zip"}]
    assert opened.info().attachment_count == len(documents) + 1
