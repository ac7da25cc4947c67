"""A workspace from elsewhere is data: no name and no link in it leads out."""

import shutil

import pytest

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.documents.enclosure import leads_out
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.models.robot import read_profile, read_robot

FILES = """
SESSIONS.md SESSIONS.rejected.md TASK.md LOG.md TARGETS.md ENVIRONMENT.md KNOWLEDGE.md RUNTIME_SIGNAL.md safety.yaml
perception.yaml runtime_contract.yaml workspace.yaml .create.lock .world/watchdog.lock .world/locks/panda.lock
.world/faults.yaml logs/watch.log logs/receive-panda.jsonl signals/estop.latch sessions/host/.lock
evidence/g.a/manifest.json evidence/objects/ab/x.npz heartbeats/panda.json .edits/.lock .cache/index.sqlite goals/g.yaml
memory/host/.lock library/skills/pour/SKILL.md
"""
FOLDERS = """
sessions goals evidence evidence/g.a memory signals signals/new inbox inbox/new heartbeats logs .cache .edits .world
library library/skills/pour
"""


@pytest.fixture
def root(tmp_path):
    return Workspace.create(tmp_path / "w", Library(())).root


def plant(root, place, outside, *, is_folder):
    path = root / place
    path.parent.mkdir(parents=True, exist_ok=True)
    if is_folder:
        shutil.rmtree(path, ignore_errors=True)
        outside.mkdir()
    else:
        path.unlink(missing_ok=True)
        outside.write_text("phy: precious\n")
    path.symlink_to(outside)
    return path


@pytest.mark.parametrize("place", [*FILES.split(), *FOLDERS.split()])
def test_a_link_in_any_place_is_named_before_anything_is_read_or_written(root, tmp_path, place):
    path = plant(root, place, tmp_path / "out", is_folder=place in FOLDERS.split())

    named = rf"{path}: LEADS_OUT: found a link to {tmp_path}/out; .* Remove it"
    with pytest.raises(DefinitionError, match=named):
        Workspace.open(root)
    with pytest.raises(DefinitionError, match=named):
        Workspace.create(root, Library(()))

    assert (tmp_path / "out").is_dir() or (tmp_path / "out").read_text() == "phy: precious\n"
    assert not (tmp_path / "out").is_dir() or not list((tmp_path / "out").iterdir())


def test_what_is_dropped_while_it_is_used_and_the_mark_of_an_editor_close_no_workspace(root):
    (root / "inbox" / "new" / "loop").symlink_to("loop")
    (root / "signals" / "new" / "loop").symlink_to("loop")
    (root / ".#SESSIONS.md").symlink_to("ann@host.4711:1")

    assert Workspace.open(root).root == root


def test_a_link_elsewhere_holds_up_no_stop(root):
    (root / "logs" / "x").symlink_to("/etc/hostname")

    assert Workspace.open(root, "signals").root == root
    with pytest.raises(DefinitionError, match="LEADS_OUT"):
        Workspace.open(root, "logs", "signals")


def test_the_workspace_itself_may_be_a_link(root, tmp_path):
    (tmp_path / "link").symlink_to(root)

    assert Workspace.open(tmp_path / "link").root == root


@pytest.mark.parametrize("name", ["../../../x", "tabletop/../../x", "{root}/x"])
def test_no_name_of_the_library_leads_out_of_it(tmp_path, name):
    (tmp_path / "x.yaml").write_text("scene: x\n")
    root = tmp_path / "a" / "b"
    (root / "scenes" / "tabletop").mkdir(parents=True)

    with pytest.raises(DefinitionError, match=r"UNKNOWN_NAME \(scene\)"):
        Library((root,)).get_scene(name.format(root=tmp_path))


@pytest.mark.parametrize(
    ("path", "folder", "expected"),
    [("a/../b", "", False), ("..", "", True), ("../b/c", "a", False), ("../../b", "a", True), ("/b", "a", True)],
)
def test_a_path_leads_out_where_it_goes_above_or_begins_at_the_root(path, folder, expected):
    assert leads_out(path, folder) == expected


@pytest.fixture
def robot(tmp_path):
    shutil.copytree(find_shipped_root() / "robots" / "panda", tmp_path / "robots" / "panda")
    return tmp_path / "robots" / "panda"


def change(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_the_model_of_a_target_lies_with_the_robots(robot):
    change(robot / "target.yaml", "model: panda.xml", "model: ../../panda.xml")

    with pytest.raises(DefinitionError, match=r"target.yaml.*model '../../panda.xml' leads out of robots/"):
        read_target(robot / "target.yaml")


@pytest.mark.parametrize(
    "asset",
    [
        '<asset><mesh name="m" file="../../secret.stl"/></asset>',
        '<compiler meshdir="../"/><asset><mesh name="m" file="&#46;&#46;/secret.stl"/></asset>',
        '<include file="/etc/more.xml"/>',
        '<include file="part.xml"/>',
    ],
)
def test_a_model_names_no_file_outside_of_the_robots(robot, asset):
    (robot / "part.xml").write_text('<mujoco><asset><hfield name="h" file="../../secret.png"/></asset></mujoco>')
    text = (robot / "panda.xml").read_text()
    (robot / "panda.xml").write_text(text.replace("</mujoco>", f"{asset}</mujoco>"))

    with pytest.raises(DefinitionError, match=r"\.xml: LEADS_OUT: found '.*(secret|more)"):
        read_robot(*read_profile(robot / "target.yaml"))
