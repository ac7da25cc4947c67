"""What a client may read of a workspace: documents, settings, proposals, and evidence that shows no hidden state.

A resource is found by walking the folders, never by joining a client's text to a path.
"""

from collections.abc import Iterator
from pathlib import Path

from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.regular_files import read_regular
from phyagentos.protocol.sessions.evidence import FAULTS
from phyagentos.protocol.settings.settings_files import SETTINGS_FILES
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.document_registry import FORMATS

TYPES = {
    ".md": "text/markdown",
    ".yaml": "application/yaml",
    ".json": "application/json",
    ".jsonl": "application/jsonl",
    ".png": "image/png",
}
_BYTES_MAX = 8 << 20


def find_resources(workspace: Workspace, bundles_max: int = 1 << 20) -> dict[str, Path]:
    """Files that may be read, by URI; of evidence the latest bundles."""
    named = {*FORMATS, *SETTINGS_FILES}
    found = {f"documents/{path.name}": path for path in _iter_files(workspace.root) if path.name in named}
    found |= {f"proposals/{path.name}": path for path in _iter_files(workspace.proposals / "new")}
    bundles = sorted(workspace.evidence.glob("*"), key=lambda path: path.lstat().st_mtime_ns)
    for bundle in bundles[max(0, len(bundles) - bundles_max) :]:
        found |= {f"evidence/{bundle.name}/{path.name}": path for path in _iter_files(bundle) if path.name != FAULTS}
    return {f"paos://{uri}": path for uri, path in found.items()}


def read_resource(workspace: Workspace, uri: str) -> tuple[bytes, str]:
    """Bytes and media type of a resource; raises DefinitionError `UNKNOWN_NAME`, `UNREADABLE_FILE`."""
    found = find_resources(workspace)
    if uri not in found:
        raise DefinitionError.of("UNKNOWN_NAME", "resources", uri[:200], "a URI that is listed", kind="resource")
    try:
        return read_regular(found[uri], _BYTES_MAX, follow=False), TYPES[found[uri].suffix]
    except OSError as error:
        raise DefinitionError.of("UNREADABLE_FILE", uri[:200], str(error)) from error


def _iter_files(folder: Path) -> Iterator[Path]:
    for path in sorted(folder.iterdir()) if folder.is_dir() and not folder.is_symlink() else ():
        if path.suffix in TYPES and not path.name.startswith(".") and path.is_file() and not path.is_symlink():
            yield path
