"""Wrong input is refused with its place; what is written is whole, and nothing of the workspace is changed."""

import json
import shutil
from pathlib import Path

import pytest
import yaml

from phyagentos.errors import DefinitionError
from phyagentos.protocol.legacy.conversion import convert
from phyagentos.protocol.legacy.documents import read_documents
from phyagentos.protocol.legacy.importer import import_legacy
from phyagentos.protocol.library import Library
from phyagentos.protocol.store.follower import Follower
from phyagentos.protocol.store.journal import choose_lane

FIXTURE = Path(__file__).parent / "legacy_fixtures" / "old"
DOCS = Path(__file__).resolve().parents[2] / "docs" / "import.md"
SESSION = {
    "session_id": "s1",
    "target_ref": "target://arm",
    "skillruntime_ref": "skillruntime://pick",
    "task_description": "pick it up",
}


@pytest.fixture
def write(tmp_path):
    def write(data, name="SESSIONS.md"):
        path = tmp_path / "old" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        text = data if isinstance(data, str) else yaml.safe_dump(data, sort_keys=False)
        path.write_text(f"# Runtime\n\n```yaml\n{text}```\n" if name.endswith(".md") else text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def sessions(write):
    def sessions(*entries):
        return write({"version": "runtime_sessions_v1", "sessions": [SESSION | entry for entry in entries]})

    return sessions


def draft_of(*paths):
    return convert(read_documents(paths))


def problems_of(*paths):
    with pytest.raises(DefinitionError) as caught:
        draft_of(*paths)
    return caught.value.problems


@pytest.mark.parametrize(
    ("text", "code", "place"),
    [
        ("", "NO_YAML_BLOCK", ":1:1"),
        ("# Nothing here\n", "NO_YAML_BLOCK", ":1:1"),
        ("```yaml\nversion: runtime_sessions_v1\n", "NO_YAML_BLOCK", ":1:1"),
        ("```yaml\n```\n", "WRONG_TYPE", ":2:1"),
        ("```yaml\n- a\n```\n", "WRONG_TYPE", ":2:1"),
        ("```yaml\nversion: [\n```\n", "YAML_SYNTAX", ":3:1"),
        ("```yaml\nversion: runtime_sessions_v1\nsessions: {}\n```\n", "WRONG_TYPE", ":3:1"),
        ("```yaml\nversion: runtime_sessions_v1\nsessions:\n  - 7\n```\n", "WRONG_TYPE", ":4:5"),
        ("```yaml\nversion: runtime_sessions_v1\nsessions:\n  - {status: pending}\n```\n", "INVALID_ID", ":4:5"),
        ("```yaml\nversion: runtime_sessions_v1\nsessions:\n  - {session_id: 7}\n```\n", "INVALID_ID", ":4:6"),
        ("```yaml\nsessions: []\n```\n", "UNKNOWN_VERSION", ":2:1"),
        ("```yaml\nversion: runtime_sessions_v9\nsessions: []\n```\n", "UNKNOWN_VERSION", ":2:1"),
        ("```yaml\nversion: runtime_sessions_v1\nversion: runtime_sessions_v1\n```\n", "DUPLICATE_KEY", ":3:1"),
        ("```yaml\nversion: runtime_sessions_v1\nat: 2026-13-45T00:00:00Z\n```\n", "YAML_SYNTAX", ":3:5"),
        ("```yaml\nversion: runtime_sessions_v1\nsessions: &a [*a]\n```\n", "YAML_SYNTAX", ":3:11"),
    ],
)
def test_a_file_that_cannot_be_read_is_refused_with_its_place(tmp_path, text, code, place):
    path = tmp_path / "SESSIONS.md"
    path.write_text(text, encoding="utf-8")

    [problem] = problems_of(path)
    assert (problem.code, problem.address) == (code, f"{path}{place}")


def test_an_unknown_version_names_the_nearest_one(write):
    [problem] = problems_of(write("version: runtime_session_v1\nsessions: []\n"))
    assert problem.hint == "Did you mean 'runtime_sessions_v1'?"


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"status": "sleeping"}, "status"),
        ({"priority": "urgent"}, "priority"),
        ({"target_ref": 7}, "target_ref"),
        ({"task_description": ["a"]}, "task_description"),
        ({"depends_on": "s0"}, "depends_on"),
        ({"timeouts": {"execute_timeout_s": -1}}, "execute_timeout_s"),
        ({"timeouts": 30}, "timeouts"),
        ({"retry": {"max_retries": "many"}}, "max_retries"),
    ],
)
def test_a_value_of_the_wrong_type_is_refused_with_its_place(sessions, change, field):
    path = sessions(change)
    [problem] = problems_of(path)

    number, line = next((n, text) for n, text in enumerate(path.read_text().splitlines(), 1) if f"{field}:" in text)
    assert problem.address == f"{path}:{number}:{line.index(field) + 1}"
    assert problem.code == "INVALID_VALUE"


def test_every_problem_of_every_file_is_told_at_once(sessions, write):
    first = sessions({"status": "sleeping"}, {"session_id": "s2", "priority": "urgent"})
    second = write({"version": "runtime_target_registry_v1", "targets": [{"id": "arm", "target_kind": "boat"}]}, "T.md")

    assert len(problems_of(first, second)) == 3


def test_two_equal_ids_are_refused_and_both_places_named(sessions):
    path = sessions({}, {"session_id": "s2"}, {"task_description": "another"})
    [problem] = problems_of(path)

    assert (problem.code, problem.address) == ("DUPLICATE_ID", f"{path}:14:3")
    assert f"{path}:6:3" in problem.hint


def test_a_session_without_a_skill_is_refused(write):
    entry = {key: value for key, value in SESSION.items() if key != "skillruntime_ref"}
    [problem] = problems_of(write({"version": "runtime_sessions_v1", "sessions": [entry]}))
    assert (problem.code, problem.expected) == ("MISSING_KEY", "key 'skillruntime_ref'")


def test_sources_are_copied_byte_for_byte_and_nothing_is_submitted(tmp_path):
    imported = import_legacy([FIXTURE], tmp_path / "w", Library(()))
    source = imported.folder / "source" / "old"

    for document in imported.documents:
        assert (source / document.path.relative_to(FIXTURE)).read_bytes() == document.path.read_bytes()
    assert not (source / "notes.md").exists()  # none of theirs
    lane = tmp_path / "w" / "sessions" / choose_lane(tmp_path / "w" / "sessions")
    assert not lane.is_dir() or list(Follower(lane).read_new()) == []
    report = json.loads((imported.folder / "report.json").read_text())
    assert len(report["remarks"]) == len(imported.draft.remarks)
    assert all(
        each.reason.replace("|", "\\|") in (imported.folder / "REPORT.md").read_text()
        for each in imported.draft.remarks
    )


def test_a_wrong_source_leaves_no_workspace_behind(tmp_path, sessions):
    with pytest.raises(DefinitionError):
        import_legacy([sessions({"status": "sleeping"})], tmp_path / "w", Library(()))
    assert not (tmp_path / "w").exists()


def test_a_disk_that_fills_up_leaves_nothing_half_imported(tmp_path, monkeypatch):
    real, calls = Path.write_text, []

    def write_text(path, *arguments, **options):
        calls.append(path)
        if len(calls) > 6:
            raise OSError(28, "No space left on device")
        return real(path, *arguments, **options)

    import_legacy([FIXTURE], tmp_path / "w", Library(()), name="first")
    monkeypatch.setattr(Path, "write_text", write_text)
    with pytest.raises(OSError, match="No space left"):
        import_legacy([FIXTURE], tmp_path / "w", Library(()), name="second")
    assert [path.name for path in (tmp_path / "w" / "imported").iterdir()] == ["first"]


def test_a_second_import_of_the_same_name_is_refused(tmp_path):
    import_legacy([FIXTURE], tmp_path / "w", Library(()))
    with pytest.raises(DefinitionError, match="ALREADY_IMPORTED"):
        import_legacy([FIXTURE], tmp_path / "w", Library(()))
    import_legacy([FIXTURE], tmp_path / "w", Library(()), name="again")


def test_a_file_named_twice_is_read_once(tmp_path):
    assert len(read_documents([FIXTURE, FIXTURE / "SESSIONS.md"])) == len(read_documents([FIXTURE]))


def test_a_workspace_inside_the_old_one_is_not_read_again(tmp_path):
    old = Path(shutil.copytree(FIXTURE, tmp_path / "old"))
    import_legacy([old], old / "new", Library(()))
    again = import_legacy([old], old / "new", Library(()), name="again")
    assert again.draft.pending == 3


def test_a_folder_without_their_documents_is_refused(tmp_path):
    (tmp_path / "readme.md").write_text("hello")
    [problem] = problems_of(tmp_path)
    assert problem.code == "NOTHING_TO_IMPORT"
