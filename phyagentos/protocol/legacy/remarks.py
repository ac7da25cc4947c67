"""What an import says about each field that it did not carry over: where it stands, and why.

Upstream: the entries and the table of fields. Downstream: the report. A field is named once; what lies below an ignored
or unknown one goes with it.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from phyagentos.errors import format_hint
from phyagentos.protocol.legacy.documents import Document, Entry
from phyagentos.protocol.legacy.fields import No, Table, To


class RemarkKind(StrEnum):
    """What became of a value."""

    IGNORED = "ignored"
    """Known, and of no use here."""
    UNKNOWN = "unknown"
    """Not in the schema of 0.1.x."""
    NOT_MAPPED = "not mapped"
    """Known and of use, but this value could not be carried over."""
    RENAMED = "renamed"
    """Carried over under another name."""
    ASSUMED = "assumed"
    """Not in the sources; written so that the draft is complete."""
    KEPT = "kept"
    """A file that is copied and not converted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Remark:
    """One remark.

    Attributes:
        kind: What became of it.
        address: `file:line:column`.
        field: Dotted path inside the entry, or the file.
        reason: One clause.
    """

    kind: RemarkKind
    address: str
    field: str
    reason: str

    def __str__(self) -> str:
        """One line."""
        return f"{self.address}: {self.kind}: {self.field}: {self.reason}"


def remark(kind: RemarkKind, entry: Entry, reason: str, *steps: str | int) -> Remark:
    """A remark about one value of an entry."""
    field = ".".join(str(step) for step in steps if isinstance(step, str)) or entry.kind.id
    return Remark(kind=kind, address=entry.address_of(*steps), field=field, reason=reason)


def iter_field_remarks(entry: Entry, *, is_history: bool = False) -> Iterator[Remark]:
    """One remark for each field that is not carried over.

    Args:
        entry: Any entry.
        is_history: The entry is kept verbatim, so that only what nobody knows is told.
    """
    table: Table = entry.kind.fields
    if not entry.kind.lists:
        table = {"version": To("the kind of document"), **table}
    for found in _iter_table(entry, table, entry.data, ()):
        if not is_history or found.kind is RemarkKind.UNKNOWN:
            yield found


def iter_document_remarks(documents: Iterable[Document]) -> Iterator[Remark]:
    """Files that are only kept, blocks that are not read, and keys beside the entries."""
    for document in documents:
        if document.kept:
            yield Remark(
                kind=RemarkKind.KEPT, address=f"{document.path}:1:1", field=document.path.name, reason=document.kept
            )
        for address in document.more_blocks:
            yield Remark(
                kind=RemarkKind.IGNORED,
                address=address,
                field="YAML block",
                reason="only the first block of a document counts, as in 0.1.x",
            )
        if document.located is None or document.kind is None or not document.kind.lists:
            continue
        for key in document.located.data:
            if key != "version" and key not in document.kind.lists:
                yield Remark(
                    kind=RemarkKind.UNKNOWN,
                    address=document.located.address_of((str(key),)),
                    field=str(key),
                    reason=_explain_unknown(str(key), document.kind.lists),
                )


def _iter_table(entry: Entry, table: Table, data: Mapping[Any, Any], path: tuple[str, ...]) -> Iterator[Remark]:
    for key, value in data.items():
        steps = (*path, str(key))
        field = table.get(key) if isinstance(key, str) else None
        if field is None:
            yield remark(RemarkKind.UNKNOWN, entry, _explain_unknown(str(key), table), *steps)
        elif isinstance(field, No):
            yield remark(RemarkKind.IGNORED, entry, field.why, *steps)
        elif isinstance(field, Mapping):
            if isinstance(value, dict):
                yield from _iter_table(entry, field, value, steps)
            elif value is not None:
                reason = f"a {type(value).__name__} where 0.1.x has a mapping"
                yield remark(RemarkKind.NOT_MAPPED, entry, reason, *steps)


def _explain_unknown(key: str, known: Iterable[str]) -> str:
    return f"not in the schema of 0.1.x. {format_hint(key, known)}".rstrip()
