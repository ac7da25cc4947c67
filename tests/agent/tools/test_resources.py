"""A client reads documents, settings, proposals and evidence of a workspace, and nothing else of this machine."""

import pytest

from phyagentos.agent.tools.resources import TYPES, find_resources, read_resource
from phyagentos.errors import DefinitionError
from phyagentos.protocol.workspace.workspace import Workspace


@pytest.fixture
def workspace(tmp_path, library):
    made = Workspace.create(tmp_path / "w", library)
    (made.root / "ENVIRONMENT.md").write_text("# The world\n")
    (made.root / "safety.yaml").write_text("targets: {}\n")
    (made.root / ".world").mkdir()
    (made.root / ".world" / "tokens.yaml").write_text("secret")
    bundle = made.evidence / "tidy-7.red"
    bundle.mkdir()
    for name in ("holds.json", "after.png", "trace.jsonl", "faults.json", "terminal.npz", "scene.xml", ".hidden.json"):
        (bundle / name).write_bytes(b"x")
    (bundle / "link.json").symlink_to(made.root / ".world" / "tokens.yaml")
    return made


def test_documents_settings_and_readable_evidence_are_listed(workspace):
    uris = [uri.removeprefix("paos://") for uri in find_resources(workspace)]
    assert {"documents/ENVIRONMENT.md", "documents/safety.yaml", "documents/TARGETS.md"} <= set(uris)
    assert [each for each in uris if each.startswith("evidence/")] == [
        "evidence/tidy-7.red/after.png",
        "evidence/tidy-7.red/holds.json",
        "evidence/tidy-7.red/trace.jsonl",
    ]
    assert "documents/workspace.yaml" not in uris


def test_what_is_listed_can_be_read(workspace):
    for uri, path in find_resources(workspace).items():
        assert read_resource(workspace, uri) == (path.read_bytes(), TYPES[path.suffix])


def test_of_evidence_the_latest_is_listed_and_all_is_read(workspace):
    assert not any("/evidence/" in uri for uri in find_resources(workspace, 0))
    assert any("/evidence/" in uri for uri in find_resources(workspace, 1))


def test_nothing_else_can_be_read(workspace):
    for uri in (
        "",
        "paos://",
        "file:///etc/passwd",
        "/etc/passwd",
        "paos://documents/../.world/tokens.yaml",
        "paos://documents/%2e%2e/x",
        "paos://documents/.world/tokens.yaml",
        "paos://evidence/../ENVIRONMENT.md",
        "paos://evidence/tidy-7.red/../../safety.yaml",
        "paos://evidence/tidy-7.red/link.json",
        "paos://evidence/tidy-7.red/faults.json",
        "paos://evidence/tidy-7.red/terminal.npz",
        "paos://evidence/*/holds.json",
        "paos://evidence/[t]idy-7.red/holds.json",
        "paos://evidence/\0",
        "paos://" + "a/" * 50_000,
    ):
        with pytest.raises(DefinitionError) as refused:
            read_resource(workspace, uri)
        assert refused.value.problems[0].label == "UNKNOWN_NAME (resource)", uri[:80]


def test_a_file_that_became_a_link_after_it_was_found_is_not_read(workspace, monkeypatch):
    uri = "paos://evidence/tidy-7.red/holds.json"
    found = find_resources(workspace)
    monkeypatch.setattr("phyagentos.agent.tools.resources.find_resources", lambda *_: found)
    found[uri].unlink()
    found[uri].symlink_to(workspace.root / ".world" / "tokens.yaml")
    with pytest.raises(DefinitionError, match="UNREADABLE_FILE"):
        read_resource(workspace, uri)
