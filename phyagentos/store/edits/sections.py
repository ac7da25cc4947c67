"""SESSIONS.md as an editor left it, compared section by section with the rendering that it was made from.

What is allowed becomes a request, as in the inbox. What else a section holds is refused, word for word; what is missing
asks for nothing, and is back with the next rendering.
"""

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from phyagentos.errors import DefinitionError, format_names
from phyagentos.protocol.documents.document import Block, iter_blocks
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import Located
from phyagentos.protocol.sessions.session import SessionId
from phyagentos.store.edits.rejections import Refused
from phyagentos.store.edits.request_form import CancelRequest, Request, SubmitRequest, parse_form, read_amendment
from phyagentos.store.views.sessions import END_MARK, NOTE_MARK

POSSIBLE = (
    "limits and priority of a pending session, 'state: cancelled' (with a line 'reason:'), or a new section "
    "'## <id>' with a YAML block 'contract:'"
)
_CANCELS = frozenset({"cancel", "cancelled", "canceled"})
_VIEW = re.compile(r"\A---[ \t]*\n(?:.*\n)?view:[ \t]*(\d{1,18})[ \t]*\n")
_OURS = re.compile(rf"{END_MARK.strip()}|{re.escape(NOTE_MARK.strip())}.*|view:[ \t]*\d+|\s*")
_Path = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Section:
    """`## name` (at `line`, counted from 1) and all text below it; without a name what stands above the first one."""

    name: str
    line: int
    text: str

    def list_lines(self) -> list[str]:
        """Every line without trailing blanks; empty where it is blank, the end mark, a note of a refusal, or 'view'."""
        return ["" if _OURS.fullmatch(line) else line for line in map(str.rstrip, self.text.split("\n"))]

    def find_block(self) -> Block | None:
        """Its first closed YAML block, None without one."""
        return next(iter_blocks(self.text), None)


@dataclass(slots=True)
class Edit:
    """What one section asks for: requests, the place of each part of them, and why the rest is refused."""

    section: Section
    requests: list[Request] = field(default_factory=list)
    located: Located = field(default_factory=lambda: Located(None, ""))
    words: list[str] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)

    def find_refused(self) -> Refused | None:
        """What is refused, for all reasons; None where everything was taken."""
        if not (self.words or self.reasons):
            return None
        return Refused(
            line=self.section.line,
            about=self.section.name or "the text above the sessions",
            reason="; ".join(self.reasons) or "words and comments are not kept, they are rendered anew",
            possible=POSSIBLE,
            text=self.section.text if self.reasons else "\n".join(self.words),
        )


def find_view(text: str) -> int | None:
    """Number of the record that a document was rendered at, None where it names none."""
    match = _VIEW.match(text)
    return int(match[1]) if match else None


def read_sections(text: str) -> Iterator[Section]:
    """The text above the sections, then each section."""
    line = 1
    for part in re.split(r"^(?=## +\S)", text, flags=re.MULTILINE):
        heading = part.partition("\n")[0] if part.startswith("## ") else ""
        yield Section(heading[3:].strip().strip("`").strip(), line, part)
        line += part.count("\n")


def compare(text: str, base: str, source: str) -> list[Edit]:
    """What each edited section asks for; `base` is the rendering that it was made from."""
    rendered = {section.name: section for section in read_sections(base)}
    changed = [
        section
        for section in read_sections(text)
        if section.name not in rendered or _list_words(section) != _list_words(rendered[section.name])
    ]
    times = Counter(section.name for section in changed)
    edits = []
    for section in changed:
        edit = Edit(section, words=list(_iter_words(section, rendered.get(section.name))))
        edits.append(edit)
        if times[section.name] > 1:
            edit.reasons.append(f"two sections are called {section.name} and both differ from what was rendered")
            continue
        try:
            _read(edit, rendered.get(section.name), source)
        except DefinitionError as error:
            edit.reasons += map(str, error.problems)
    return edits


def _list_words(section: Section) -> list[str]:
    return [line for line in section.list_lines() if line]


def _iter_words(section: Section, rendered: Section | None) -> Iterator[str]:
    """Lines that were not rendered and are no YAML, or hold a comment."""
    block = section.find_block()
    known = Counter(rendered.list_lines() if rendered is not None else [section.text.partition("\n")[0].rstrip()])
    end = block.line + block.yaml.count("\n") if block is not None else 0
    for number, line in enumerate(section.list_lines(), 1):
        known[line] -= 1
        is_yaml = block is not None and block.line - (rendered is None) <= number < end + (rendered is None)
        if line and known[line] < 0 and not (is_yaml and "#" not in line):
            yield line


def _read(edit: Edit, rendered: Section | None, source: str) -> None:
    block = edit.section.find_block()
    if block is None:
        edit.reasons += ["it has no YAML block that is closed"] if rendered is None else []
        return  # words, or a block that was deleted
    edit.located = located = parse_form(block.yaml, source, edit.section.line + block.line - 1)
    before = rendered.find_block() if rendered is not None else None
    if before is None:
        data = located.data if isinstance(located.data, dict) else {}
        others = [str(key) for key in data if key != "contract" and (key, data[key]) != ("state", "pending")]
        if others or "contract" not in data:
            found = f"found {format_names(others)}" if others else "found none"
            edit.reasons.append(f"{located.address_of(())}: a new section has only 'contract', {found}")
        else:
            edit.requests.append(SubmitRequest(kind="submit", contract={}))
        return
    old, new = dict(_flatten(parse_form(before.yaml, source).data)), dict(_flatten(located.data))
    changed = {path: value for path, value in new.items() if path not in old or not _is_same(value, old[path])}
    _amend(edit, changed, str(new.get(("reason",), "")))


def _amend(edit: Edit, changed: Mapping[_Path, Any], reason: str) -> None:
    """Every field that differs from the rendering."""
    id = SessionId(edit.section.name)
    wanted: Fields = {"limits": {}}
    ends = str(changed.get(("state",))) in _CANCELS
    if ends:
        edit.requests.append(CancelRequest(kind="cancel", session=id, reason=reason))
    for path, value in changed.items():
        if path[:2] == ("contract", "limits") and len(path) == 3:
            wanted["limits"][path[2]] = value
        elif path == ("contract", "priority"):
            wanted["priority"] = value
        elif not (ends and path in {("state",), ("reason",)}):
            edit.reasons.append(f"{'.'.join(path) or 'the block'}: {_explain_fixed(path)}")
    if wanted != {"limits": {}}:
        edit.requests.append(read_amendment(edit.located, id, wanted))


def _flatten(data: object, path: _Path = ()) -> Iterator[tuple[_Path, Any]]:
    """Every leaf with its path; lists and empty mappings are leaves."""
    if isinstance(data, dict) and data:
        for key, each in data.items():
            yield from _flatten(each, (*path, str(key)))
    else:
        yield path, data


def _is_same(one: object, other: object) -> bool:
    """Whether two values are the same in YAML: true is not 1, but 60 is 60.0."""
    return isinstance(one, bool) == isinstance(other, bool) and bool(one == other)


def _explain_fixed(path: _Path) -> str:
    if path == ("state",):
        return "a state follows from records, and a verdict from evidence"
    return "a contract stands as it was submitted" if path[:1] == ("contract",) else "this comes from the journal"
