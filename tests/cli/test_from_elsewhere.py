"""What comes from elsewhere is data: its Python runs only when asked for, and it leads nowhere."""

import os
import py_compile
import sys
from pathlib import Path

import pytest

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.execution.leaf_registry import LeafRegistry, register_file
from tests.command_line import assert_refused

ROOT = Path(__file__).resolve().parents[2]
SKILL = "---\nskill: nod\ndescription: Nod.\ntree: nod\n---\n\n# nod\n"
TREE = "tree: nod\ndescription: Nod.\nroot:\n  sequence:\n    children:\n      - nod_once: {deep: true, seen: $seen}\n"
TREE += "      - nod_again: {seen: $seen}\n      - for_each: {each: $one, in: $seen, child: {locate: {object: $one}}}\n"
PYTHON = """from pathlib import Path
Path(__file__).with_name("ran").touch()
from phyagentos.runtime.execution.leaves.wait import Wait
def register(registry):
    registry.register("nod_once", Wait)
    registry.register("nod_again", Wait)
"""


def put(root, name, text):
    path = root / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A project with a skill of its own, as the working folder."""
    root = tmp_path / "project"
    put(root, "skills/nod/SKILL.md", SKILL)
    put(root, "trees/nod.yaml", TREE)
    put(root, "skills/nod/behaviours.py", PYTHON)
    monkeypatch.chdir(root)
    return root


def has_run(project):
    return (project / "skills" / "nod" / "ran").exists()


def test_linting_a_folder_executes_nothing_and_knows_its_leaves(paos, project):
    result = paos("lint", project)

    assert (result.code, result.out) == (0, "2 files checked, no problem\n"), result.err
    assert not has_run(project)


def test_linting_executes_what_it_is_asked_to_and_checks_ports_then(paos, project):
    assert_refused(paos("lint", project, "--run-python"), "nod.yaml:6:20: UNKNOWN_NAME (port): found 'deep'; expected")
    assert has_run(project)


def test_a_leaf_that_no_file_announces_is_unknown_all_the_same(paos, project):
    put(project, "trees/nod.yaml", TREE.replace("nod_once", "nod_onec"))
    assert_refused(paos("lint", project), "UNKNOWN_NAME (leaf): found 'nod_onec'", "Did you mean 'nod_once'?")


@pytest.mark.parametrize("text", ["def register(:\n", "\0", "(" * 5000])
def test_what_is_no_python_is_told_without_executing_it(paos, project, text):
    put(project, "skills/nod/behaviours.py", text)
    assert_refused(paos("lint", project), "behaviours.py:1:", "BROKEN_PYTHON")


def test_leaves_are_listed_without_executing_them(paos, project):
    result = paos("list", "leaves")

    assert {"nod_once", "nod_again", "locate"} <= set(result.out.split())
    assert not has_run(project)
    assert paos("list", "leaves", "--run-python").out == result.out
    assert has_run(project)


@pytest.fixture
def foreign(project, tmp_path, monkeypatch):
    """A workspace made from that project, seen from another folder."""
    root = Workspace.create(tmp_path / "w", Library.open(project)).root
    (tmp_path / "mine").mkdir()
    monkeypatch.chdir(tmp_path / "mine")
    return root


COMMANDS = [
    ("watch",),
    ("run", ROOT / "goal_graphs" / "tidy_table.yaml"),
    ("preflight", ROOT / "goal_graphs" / "tidy_table.yaml"),
]


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command[0])
def test_python_that_is_not_known_from_here_is_named_and_not_run(paos, foreign, command):
    before = sorted(foreign.rglob("*"))
    assert_refused(
        paos(*command, "--workspace", foreign),
        f"{foreign}/library/skills/nod/behaviours.py: UNTRUSTED_PYTHON: found other Python",
        "Read it; --trust-python lets it run.",
    )
    assert sorted(foreign.rglob("*")) == before


def start_nothing(monkeypatch):
    """Let `watch` end where it would begin to supervise."""
    monkeypatch.setattr("phyagentos.assembly.runtime_plane.run_watch", lambda *_, **__: None)


@pytest.mark.parametrize("place", ["project", "mine"])
def test_python_of_the_project_or_allowed_is_run(paos, foreign, project, monkeypatch, place):
    start_nothing(monkeypatch)
    monkeypatch.chdir(project.parent / place)
    result = paos("watch", "--workspace", foreign, *(["--trust-python"] if place == "mine" else []))

    path = foreign / "library" / "skills" / "nod" / "behaviours.py"
    begins = f"runtime of {foreign}: claims, checks and runs what an agent submits; Ctrl-C ends\n"
    trusted = f"trusted Python: {path}\n" if place == "mine" else ""
    assert (result.code, result.err) == (0, begins + trusted)


@pytest.mark.parametrize("name", ["behaviours.py", "helper.py", "__pycache__/helper.cpython-311.pyc"])
def test_python_that_was_changed_or_added_in_the_workspace_is_not_that_of_the_project(
    paos, foreign, project, monkeypatch, name
):
    start_nothing(monkeypatch)
    monkeypatch.chdir(project)
    put(foreign, f"library/skills/nod/{name}", PYTHON + "# more\n")

    assert "UNTRUSTED_PYTHON" in paos("watch", "--workspace", foreign).err


def test_a_workspace_does_not_vouch_for_itself(paos, foreign, monkeypatch):
    start_nothing(monkeypatch)
    monkeypatch.chdir(foreign / "library")

    assert "UNTRUSTED_PYTHON" in paos("watch", "--workspace", foreign).err


def test_what_is_executed_is_the_text_and_no_cached_form_of_it(tmp_path, monkeypatch):
    source = "def register(registry):\n    registry.bad\n"
    path = put(tmp_path, "skills/nod/behaviours.py", source)
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    cached = py_compile.compile(str(path), doraise=True)
    stat = path.stat()
    path.write_text("def register(registry):\n    registry.good\n")  # as long, and as old: the cached form seems right
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    assert Path(cached).exists()

    with pytest.raises(DefinitionError, match="good"):
        register_file(LeafRegistry(), path)


STOPS = [("estop", "--reason", "x"), ("cancel", "all"), ("pause", "all")]


@pytest.mark.parametrize("command", [("watch",), ("why", "x"), ("store", "check"), ("evidence", "verify"), *STOPS])
def test_a_link_in_a_workspace_is_refused_by_every_command_but_a_stop(paos, tmp_path, command):
    root = Workspace.create(tmp_path / "w", Library.open()).root
    victim = put(tmp_path, "victim", "precious\n")
    (root / "logs" / "watch.log").symlink_to(victim)
    result = paos(*command, *([] if command[0] == "store" else ["--workspace"]), root)

    if command in STOPS:
        assert result.code == 0, result.err
    else:
        assert (result.code, "LEADS_OUT: found a link to" in result.err) == (2, True), result.err
    assert victim.read_text() == "precious\n"


def test_the_shipped_skills_bring_no_python():
    assert list(Library((find_shipped_root(),)).iter_behaviours()) == []
