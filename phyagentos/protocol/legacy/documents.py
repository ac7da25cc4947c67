"""Documents of the 0.1.x system, read with the place of every value: Markdown with one fenced YAML block, or YAML.

Upstream: files that a person names. Downstream: `conversion`. Nothing is written here, and every problem of every file
is found before anything is.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from phyagentos.errors import DefinitionError, Problem, format_hint, format_names
from phyagentos.protocol.legacy.fields import KEPT, KINDS, Kind
from phyagentos.protocol.schema import Address, Located, parse_yaml
from phyagentos.protocol.workspace import MARKER

_FENCE = re.compile(r"^(?P<fence>`{3,}|~{3,})ya?ml[^\n]*\n(?P<yaml>.*?)^(?P=fence)\s*$", re.DOTALL | re.MULTILINE)
_VERSION = re.compile(r"^\s*[\"']?version[\"']?\s*:\s*[\"']?(runtime_\w+_v\d+)", re.MULTILINE)
_SUFFIXES = frozenset({".md", ".yaml", ".yml"})
REGISTRIES = frozenset({"SESSIONS.md", "TARGETS.md", "SKILLRUNTIME.md", "SKILLS.md"})
ALSO_KEPT = frozenset({"ENVIRONMENT.md", "LESSONS.md", "LOG.md", "TASK.md", "ORCHESTRATOR.md", "RUNTIME.md"})


@dataclass(frozen=True, slots=True, kw_only=True)
class Document:
    """One file.

    Attributes:
        path: As the person named it.
        copy: Its path in the copy of the sources.
        data: Its bytes.
        located: Its YAML; None for a file that is only kept.
        kind: What it holds; None for a file that is only kept.
        kept: Why it is only kept.
        more_blocks: Addresses of YAML blocks after the first, which 0.1.x did not read either.
    """

    path: Path
    copy: Path
    data: bytes
    located: Located | None = None
    kind: Kind | None = None
    kept: str = ""
    more_blocks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One session, target, skill or contract, and where it stands."""

    kind: Kind
    located: Located
    path: Address
    data: dict[Any, Any]

    def address_of(self, *steps: str | int) -> str:
        """`file:line:column` of a value of this entry."""
        return self.located.address_of((*self.path, *steps))


def read_documents(sources: Iterable[Path]) -> list[Document]:
    """Read what was named: files, and in folders every file that says it belongs to 0.1.x.

    Raises:
        DefinitionError: With every problem of every file; `NOTHING_TO_IMPORT` when there is none.
    """
    documents: list[Document] = []
    problems: list[Problem] = []
    seen: set[Path] = set()
    for source in sources:
        for path, copy in _iter_files(source):
            if path.resolve() in seen:
                continue
            seen.add(path.resolve())
            try:
                document = _read(path, copy, is_asked=path == source)
            except DefinitionError as error:
                problems += error.problems
                continue
            if document is not None:
                documents.append(document)
    if problems:
        raise DefinitionError(problems)
    if not any(document.kind for document in documents):
        shown = ", ".join(str(source) for source in sources)
        raise DefinitionError(
            Problem(
                code="NOTHING_TO_IMPORT",
                address=shown,
                found="no document of the 0.1.x system",
                expected=f"a file whose key 'version' is one of {format_names(KINDS)}",
                hint="Name the old workspace, or its files.",
            )
        )
    return documents


def read_entries(documents: Iterable[Document]) -> list[Entry]:
    """Every session, target, skill and contract.

    Raises:
        DefinitionError: With every problem: a list that is none, an entry that is no mapping, two ids equal.
    """
    entries: list[Entry] = []
    problems: list[Problem] = []
    seen: dict[tuple[str, str], str] = {}
    for document in documents:
        for entry in _iter_entries(document, problems):
            id = entry.data.get(entry.kind.id)
            if not isinstance(id, str) or not id.strip():
                found = "nothing" if id is None else repr(id)
                at = entry.address_of(entry.kind.id)
                problems.append(
                    Problem(code="INVALID_ID", address=at, found=found, expected=f"{entry.kind.id}: a text")
                )
                continue
            at = entry.address_of(entry.kind.id)
            first = seen.setdefault((entry.kind.version, id), at)
            if first != at:
                hint = f"The first one is at {first}. Rename one of them."
                problems.append(
                    Problem(code="DUPLICATE_ID", address=at, found=repr(id), expected="a new id", hint=hint)
                )
            entries.append(entry)
    if problems:
        raise DefinitionError(problems)
    return entries


def _iter_files(source: Path) -> Iterator[tuple[Path, Path]]:
    """The files of a source, each with its path in the copy."""
    if not source.is_dir():
        yield source, Path(source.name)
        return
    name = source.resolve().name
    ours = {path.parent for path in source.rglob(MARKER)}  # workspaces of this system, with copies of earlier imports
    for path in sorted(source.rglob("*")):
        inside = path.relative_to(source)
        is_hidden = any(part.startswith(".") for part in inside.parts)
        if path.suffix in _SUFFIXES and path.is_file() and not is_hidden and ours.isdisjoint(path.parents):
            yield path, Path(name) / inside


def _read(path: Path, copy: Path, *, is_asked: bool) -> Document | None:
    """One file; None when it is none of theirs and nobody asked for it by name."""
    try:
        data = path.read_bytes()
        text = data.decode("utf-8-sig").replace("\r\n", "\n")
    except (OSError, UnicodeDecodeError) as error:
        if not is_asked and path.name not in REGISTRIES | ALSO_KEPT:
            return None
        problem = Problem(code="UNREADABLE_FILE", address=str(path), found=str(error), hint="Check path and encoding.")
        raise DefinitionError(problem) from error
    is_asked = is_asked or path.name in REGISTRIES
    if not is_asked and path.name in ALSO_KEPT:
        return Document(path=path, copy=copy, data=data, kept="not converted: a view or notes of theirs")
    if not is_asked and _VERSION.search(text) is None:
        return None
    located, more = _parse(path, text)
    version = located.data.get("version") if isinstance(located.data, dict) else None
    if isinstance(version, str) and version in KEPT:
        return Document(path=path, copy=copy, data=data, kept=f"not converted: {KEPT[version]}")
    return Document(
        path=path, copy=copy, data=data, located=located, kind=_get_kind(located, version), more_blocks=more
    )


def _parse(path: Path, text: str) -> tuple[Located, tuple[str, ...]]:
    more: tuple[str, ...] = ()
    first_line = 1
    if path.suffix != ".md":
        located = _parse_yaml(text, str(path), first_line)
    else:
        blocks = [(match["yaml"], text.count("\n", 0, match.start("yaml")) + 1) for match in _FENCE.finditer(text)]
        if not blocks:
            raise DefinitionError(
                Problem(
                    code="NO_YAML_BLOCK",
                    address=f"{path}:1:1",
                    found="an empty file" if not text.strip() else "no complete fenced block",
                    expected="one block between ```yaml and ```",
                )
            )
        first_line = blocks[0][1]
        located = _parse_yaml(blocks[0][0], str(path), first_line)
        more = tuple(f"{path}:{line}:1" for _, line in blocks[1:])
    if not isinstance(located.data, dict):
        found = "nothing" if located.data is None else type(located.data).__name__
        address = f"{path}:{first_line}:1"
        raise DefinitionError(Problem(code="WRONG_TYPE", address=address, found=found, expected="a mapping"))
    return located, more


def _parse_yaml(text: str, source: str, first_line: int) -> Located:
    try:
        return parse_yaml(text, source, first_line)
    except (
        RecursionError,
        ValueError,
        TypeError,
    ) as error:  # nested too deep, a date that is none, a key that is a list
        found = f"{type(error).__name__}: {error}".split("\n", 1)[0][:120]
        raise DefinitionError(
            Problem(code="YAML_SYNTAX", address=f"{source}:{first_line}:1", found=found, expected="plain YAML")
        ) from error


def _get_kind(located: Located, version: object) -> Kind:
    if isinstance(version, str) and version in KINDS:
        return KINDS[version]
    known = [*KINDS, *KEPT]
    found = "no key 'version'" if version is None else repr(version)
    hint = format_hint(version, known) if isinstance(version, str) else "Is this a document of the 0.1.x system?"
    raise DefinitionError(located.problem("UNKNOWN_VERSION", ("version",), found, format_names(known), hint))


def _iter_entries(document: Document, problems: list[Problem]) -> Iterator[Entry]:
    if document.kind is None or document.located is None:
        return
    located, kind = document.located, document.kind
    if not kind.lists:
        yield Entry(kind=kind, located=located, path=(), data=located.data)
        return
    for key in kind.lists:
        items = located.data.get(key)
        if items is None:
            continue
        if not isinstance(items, list):
            problems.append(located.problem("WRONG_TYPE", (key,), type(items).__name__, "a list"))
            continue
        for index, item in enumerate(items):
            if isinstance(item, dict):
                yield Entry(kind=kind, located=located, path=(key, index), data=item)
            else:
                problems.append(located.problem("WRONG_TYPE", (key, index), type(item).__name__, "a mapping"))
