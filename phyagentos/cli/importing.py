"""`paos import`: documents of the public 0.1.x system, converted to drafts."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from phyagentos.cli.outcome import print_note, print_result

if TYPE_CHECKING:
    from phyagentos.protocol.legacy.importer import Imported


def register(app: typer.Typer) -> None:
    """Add this group's commands."""
    app.command("import")(import_)


def import_(
    sources: Annotated[list[Path], typer.Argument(metavar="SOURCE...", help="The old workspace, or files of it.")],
    workspace: Annotated[Path, typer.Option("--workspace", "-w", help="Where to; created when missing.")],
    name: Annotated[str, typer.Option(help="Folder below imported/; named after the source by default.")] = "",
    as_json: Annotated[bool, typer.Option("--json", help="The whole report as JSON on stdout.")] = False,
) -> None:
    """Convert SESSIONS, TARGETS, SKILLRUNTIME and contracts of 0.1.x to drafts; report all that is not carried over."""
    from phyagentos.cli.projects import open_library
    from phyagentos.protocol.legacy.importer import import_legacy

    imported = import_legacy(sources, workspace, open_library(), name=name)
    if as_json:
        print_result(json.dumps(imported.to_plain(), indent=2, ensure_ascii=False))
        return
    print_result("\n".join(_describe(imported)))
    print_note(f"next: paos lint {imported.folder / 'project'}")


def _describe(imported: "Imported") -> list[str]:
    """One line a kind of remark and field, so that a thousand sessions are told as shortly as one."""
    groups: dict[tuple[str, str, str], list[str]] = {}
    for each in imported.draft.remarks:
        groups.setdefault((each.kind.value, each.field, each.reason), []).append(each.address)
    lines = [
        f"{addresses[0]}: {kind}: {field}: {reason}" + (f" (and {len(addresses) - 1} more)" if addresses[1:] else "")
        for (kind, field, reason), addresses in groups.items()
    ]
    draft = imported.draft
    count = len(draft.remarks)
    return [
        *lines,
        f"{draft.pending} pending sessions became nodes, {draft.past} others history; "
        f"{count} remark{'s' if count != 1 else ''}, each in {imported.folder / 'REPORT.md'}",
    ]
