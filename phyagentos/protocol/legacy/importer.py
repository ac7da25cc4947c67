"""Writes an import into a workspace: drafts, history, report and a copy of the sources, all at once or not at all.

Upstream: `paos import`. Downstream: people. Everything goes to `imported/<name>/`; nothing is submitted, nothing that
the workspace holds is changed.
"""

import json
import os
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.legacy.conversion import Draft, convert
from phyagentos.protocol.legacy.documents import Document, read_documents
from phyagentos.protocol.library import Library
from phyagentos.protocol.markdown import render_table
from phyagentos.protocol.workspace import Workspace

FOLDER = "imported"
HISTORY, REPORT, REPORT_JSON = "HISTORY.md", "REPORT.md", "report.json"
PROJECT, SOURCE = "project", "source"


@dataclass(frozen=True, slots=True, kw_only=True)
class Imported:
    """What an import wrote.

    Attributes:
        folder: `imported/<name>/`.
        documents: What was read.
        draft: What it became.
    """

    folder: Path
    documents: tuple[Document, ...]
    draft: Draft

    def to_plain(self) -> dict[str, Any]:
        """As `report.json` and `--json` tell it."""
        files = sorted(self.draft.files)
        return {
            "folder": str(self.folder),
            "sources": [str(document.path) for document in self.documents],
            "pending": self.draft.pending,
            "past": self.draft.past,
            "goal_graphs": [name for name in files if name.startswith("goal_graphs/")],
            "targets": [name for name in files if name.startswith("robots/")],
            "skills": [name for name in files if name.startswith("skills/")],
            "remarks": [asdict(each) for each in self.draft.remarks],
        }


def import_legacy(sources: Sequence[Path], root: Path, library: Library, *, name: str = "") -> Imported:
    """Read documents of 0.1.x and write what they become.

    Args:
        sources: Files, or folders of the old system.
        root: The workspace; made when it is missing.
        library: What a new workspace is made from.
        name: Of the folder below `imported/`; that of the first source when empty.

    Raises:
        DefinitionError: With every problem of every source, or `ALREADY_IMPORTED`; nothing was written then.
    """
    documents = tuple(read_documents(sources))
    draft = convert(documents)
    name = name or (sources[0].resolve().name if sources[0].is_dir() else sources[0].resolve().stem).lower()
    _check_name(name)
    folder = root.resolve() / FOLDER / name
    if folder.exists():
        problem = Problem(
            code="ALREADY_IMPORTED",
            address=str(folder),
            found="an earlier import",
            expected="a folder that is not there",
            hint="Remove it, or give another name with --name.",
        )
        raise DefinitionError(problem)
    imported = Imported(folder=folder, documents=documents, draft=draft)
    Workspace.create(root, library)
    temporary = folder.with_name(f".{name}.{os.getpid()}.tmp")
    try:
        _write(imported, temporary)
        temporary.rename(folder)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise
    return imported


def _check_name(name: str) -> None:
    if not name or name.startswith(".") or Path(name).name != name:
        raise DefinitionError(
            Problem(code="INVALID_NAME", address="--name", found=repr(name), expected="the name of one folder")
        )


def _write(imported: Imported, folder: Path) -> None:
    texts = {f"{PROJECT}/{name}": text for name, text in imported.draft.files.items()}
    texts[REPORT] = _render_report(imported)
    texts[REPORT_JSON] = json.dumps(imported.to_plain(), indent=2, ensure_ascii=False) + "\n"
    if imported.draft.history:
        texts[HISTORY] = imported.draft.history
    for name, text in texts.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    for document in imported.documents:
        path = _find_free(folder / SOURCE / document.copy)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(document.data)


def _find_free(path: Path) -> Path:
    number, free = 2, path
    while free.exists():
        free, number = path.with_name(f"{path.stem}-{number}{path.suffix}"), number + 1
    return free


def _render_report(imported: Imported) -> str:
    draft = imported.draft
    rows = ((each.kind, each.field, each.address, each.reason) for each in draft.remarks)
    sources = "".join(f"- `{document.path}`\n" for document in imported.documents)
    return (
        "# Import from 0.1.x\n\n"
        f"{draft.pending} pending sessions became nodes in `{PROJECT}/goal_graphs/`; {draft.past} others\n"
        f"stand in `{HISTORY}` as claims of the old system. Nothing was submitted. Complete the drafts, check them\n"
        f"with `paos lint {PROJECT}`, then `paos run` a goal graph.\n\n## Sources\n\n{sources}\n"
        "## What was not carried over\n\n" + render_table(("what", "field", "at", "why"), rows)
    )
