"""A workspace is made once, keeps its copies, and never settles in somebody else's folder."""

import errno
import shutil

import pytest
import yaml

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.registries import read_skill_registry, read_target_registry
from phyagentos.protocol.sessions import estop
from phyagentos.protocol.settings.runtime_contract import read_runtime_contract
from phyagentos.protocol.settings.settings_files import declare
from phyagentos.protocol.workspace.workspace import MARKER, Workspace

SKILL = """---
skill: wave
description: Wave | at people.
tree: wave
guarantees: ["at(${target}, home)"]
parameters:
  times: {type: integer, default: 2, minimum: 1}
---

# wave
"""
TARGET = """target: toy
description: A toy arm.
model: toy.xml
arm:
  joints: [a]
  home_rad: [0.0]
  velocity_rad_s: [1.0]
  acceleration_rad_s2: [1.0]
  jerk_rad_s3: [1.0]
  torque_nm: [1.0]
  stiffness_nm_rad: [1.0]
  damping_nms_rad: [1.0]
gripper:
  {joints: [f], pads: [p], max_width_m: 0.08, stiffness_n_m: 1.0, damping_ns_m: 1.0, force_n: 1.0}
capabilities: [manipulation]
"""


def put(root, name, text):
    path = root / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


FILES = {
    "mine": {"skills/wave/SKILL.md": SKILL, "trees/wave.yaml": "tree: mine\n"},
    "shipped": {
        "skills/wave/SKILL.md": SKILL.replace("Wave |", "Shipped"),
        "skills/wave/behaviours.py": "# of the shipped skill\n",
        "skills/nod/SKILL.md": SKILL.replace("wave", "nod"),
        "skills/nod/behaviours.py": "# nod\n",
        "skills/nod/__pycache__/behaviours.pyc": "litter",
        "trees/wave.yaml": "tree: shipped\n",
        "trees/sub/nod.yaml": "tree: nod\n",
        "scenes/tabletop/toys.yaml": "scene: toys\n",
        "robots/toy/target.yaml": TARGET,
        "robots/toy/toy.xml": "<mujoco/>\n",
        "protocol/LESSONS.md": "# Lessons\n",
        "protocol/safety.yaml": "version: 1\n",
        "protocol/schemas/tree.json": "{}",
    },
}


@pytest.fixture
def library(tmp_path):
    for root, files in FILES.items():
        for name, text in files.items():
            put(tmp_path / root, name, text)
    return Library((tmp_path / "mine", tmp_path / "shipped"))


@pytest.fixture
def workspace(tmp_path, library):
    return Workspace.create(tmp_path / "w", library)


def list_files(root):
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in root.rglob("*") if path.is_file()}


def test_the_first_root_wins_and_objects_are_never_mixed(workspace):
    copies = set(list_files(workspace.library_root))

    assert copies == {
        "robots/toy/target.yaml",
        "robots/toy/toy.xml",
        "scenes/tabletop/toys.yaml",
        "skills/nod/SKILL.md",
        "skills/nod/behaviours.py",
        "skills/wave/SKILL.md",
        "trees/sub/nod.yaml",
        "trees/wave.yaml",
    }
    assert (workspace.library_root / "trees/wave.yaml").read_text() == "tree: mine\n"
    assert workspace.library().names_of_trees() == ["sub/nod", "wave"]
    assert workspace.library().get_skill("nod").is_relative_to(workspace.root)


def test_pristine_documents_are_copied_and_missing_ones_are_no_error(workspace):
    assert workspace.lessons.read_text() == "# Lessons\n"
    assert workspace.safety.exists()
    assert not workspace.knowledge.exists()
    assert not (workspace.root / "schemas").exists()


def test_a_workspace_made_twice_is_the_same_and_keeps_what_people_wrote(tmp_path, library, workspace):
    workspace.safety.write_text("version: 1 # mine\n")
    put(tmp_path / "shipped", "skills/late/SKILL.md", SKILL.replace("wave", "late"))
    before = list_files(workspace.root)
    again = Workspace.create(tmp_path / "w", library)

    assert again == workspace
    assert list_files(workspace.root) == before


def test_an_interrupted_creation_is_completed(tmp_path, library, workspace):
    expected = list_files(workspace.root)
    (workspace.root / MARKER).unlink()
    shutil.rmtree(workspace.library_root / "skills" / "nod")
    put(workspace.library_root, "skills/.nod.tmp/SKILL.md", "half")
    workspace.skill_registry.unlink()
    Workspace.create(tmp_path / "w", library)

    assert list_files(workspace.root) == expected


def test_the_registries_are_read_back_as_they_were_declared(workspace):
    skills, targets = read_skill_registry(workspace.skill_registry), read_target_registry(workspace.target_registry)

    assert sorted(skills) == ["nod", "wave"]
    wave, toy = skills["wave"], targets["toy"]
    assert (wave.description, wave.guarantees) == ("Wave | at people.", ("at(${target}, home)",))
    assert (wave.parameters["times"].minimum, toy.gripper.max_width_m, toy.capabilities) == (1, 0.08, ("manipulation",))
    assert "| wave | Wave \\| at people. | `at(${target}, home)` | wave |" in workspace.skill_registry.read_text()


def test_a_registry_that_was_spoiled_names_line_and_key(tmp_path, workspace):
    text = workspace.skill_registry.read_text().replace("tree: wave", "trea: wave")
    workspace.skill_registry.write_text(text)
    line = text.split("\n").index("trea: wave") + 1

    with pytest.raises(
        DefinitionError, match=rf"SKILLRUNTIME.md:{line}:1: UNKNOWN_NAME \(key\): found 'trea'.*Did you mean 'tree'"
    ):
        read_skill_registry(workspace.skill_registry)
    with pytest.raises(DefinitionError, match=r"UNREADABLE_FILE.*Is this a workspace\?"):
        read_target_registry(tmp_path / "nowhere" / "TARGETS.md")


def test_every_problem_of_every_skill_and_target_is_reported(tmp_path, library):
    put(tmp_path / "mine", "skills/bad/SKILL.md", "no front matter\n")
    put(tmp_path / "mine", "skills/worse/SKILL.md", SKILL.replace("skill: wave", "skill: better"))
    with pytest.raises(DefinitionError, match=r"(?s)MISSING_VALUE.*INVALID_VALUE: found 'better'"):
        Workspace.create(tmp_path / "w", library)

    shutil.rmtree(tmp_path / "mine")
    put(tmp_path / "shipped", "robots/other/target.yaml", TARGET)
    with pytest.raises(DefinitionError, match="INVALID_VALUE: found 'toy'; expected the folder's name 'other'"):
        Workspace.create(tmp_path / "v", library)

    shutil.rmtree(tmp_path / "shipped" / "robots" / "other")
    assert sorted(read_target_registry(Workspace.create(tmp_path / "v", library).target_registry)) == ["toy"]


def test_a_folder_of_somebody_else_is_left_alone(tmp_path, library):
    put(tmp_path, "home/thesis.tex", "precious")

    with pytest.raises(DefinitionError, match=r"home: NOT_A_WORKSPACE: found thesis.tex; expected .*empty folder"):
        Workspace.create(tmp_path / "home", library)
    with pytest.raises(DefinitionError, match=r"thesis.tex: NOT_A_WORKSPACE: found a file"):
        Workspace.create(tmp_path / "home" / "thesis.tex", library)
    assert list_files(tmp_path / "home") == {"thesis.tex": b"precious"}


def test_opening_asks_for_a_workspace(tmp_path, workspace):

    assert Workspace.open(tmp_path / "w") == workspace
    with pytest.raises(DefinitionError, match="NOT_A_WORKSPACE: found no such folder"):
        Workspace.open(tmp_path / "nowhere")
    with pytest.raises(DefinitionError, match=r"NOT_A_WORKSPACE: found no workspace.yaml"):
        Workspace.open(tmp_path)


def test_the_layout_is_there(workspace):
    for folder in (
        *(workspace.sessions, workspace.goals, workspace.evidence, workspace.signals, workspace.heartbeats),
        *(workspace.logs, workspace.cache, workspace.inbox / "new", workspace.inbox / "tmp"),
    ):
        assert folder.is_dir(), folder
    assert workspace.evidence_of("g.red") == workspace.root / "evidence" / "g.red"
    assert workspace.goal_file_of("g") == workspace.root / "goals" / "g.yaml"
    documents = {
        *(workspace.sessions_document, workspace.task, workspace.log, workspace.environment, workspace.runtime_signal),
        *(workspace.sensors, workspace.perception, workspace.runtime_contract),
    }
    assert {path.parent for path in documents} == {workspace.root}
    assert len(documents) == 8


def test_every_workspace_can_latch_the_emergency_stop_on_a_full_disk(tmp_path, monkeypatch):
    signals = Workspace.create(tmp_path / "w", Library(())).signals.parent

    def refuse(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(estop, "_link", refuse)
    estop.latch(signals, estop.Latch(by="me"))

    assert estop.is_latched(signals)


def test_limits_beside_a_profile_are_added_unless_the_site_has_its_own(tmp_path, library):
    put(tmp_path / "shipped", "robots/toy/safety.yaml", "version: 1\ntargets:\n  toy:\n    own: 1\n")
    for folder, text, expected in (
        ("a", "version: 1\ntargets:\n  panda:\n    x: 1\n", {"panda": {"x": 1}, "toy": {"own": 1}}),
        ("b", "version: 1\ntargets:\n  toy:\n    x: 2\n", {"toy": {"x": 2}}),
        ("c", "version: 1\ntargets: {}\n", {}),
    ):
        put(tmp_path / "shipped", "protocol/safety.yaml", text)
        workspace = Workspace.create(tmp_path / folder, Library((tmp_path / "shipped",)))
        assert yaml.safe_load(workspace.safety.read_text())["targets"] == expected


def test_a_share_of_the_speed_limits_is_noted_once_and_nothing_else_changes(tmp_path):
    path = Workspace.create(tmp_path / "w", Library.open()).runtime_contract
    before = path.read_text()
    for speed in (1.0, 0.5, 0.25):
        declare(path, speed=speed)
        assert read_runtime_contract(path).speed == speed
    assert path.read_text() == f"{before.rstrip()}\nspeed: 0.25\n"
