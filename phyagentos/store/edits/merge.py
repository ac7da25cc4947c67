"""The three-way merge of SESSIONS.md, field by field: the rendering, its edited copy, and the present.

It never guesses: a missing section or line asks for nothing, and an illegal edit is refused with line and reason.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from phyagentos.errors import DefinitionError, format_hint, format_names
from phyagentos.protocol.documents.schema import Located
from phyagentos.protocol.sessions.session import PRIORITY_MAX, Amendment, Limits, SessionId, SessionStatus
from phyagentos.store.admission import Entry
from phyagentos.store.edits.changes import CANCELS, Accepted, Impossible, Refused, plan_amend, plan_cancel, plan_submit
from phyagentos.store.edits.form import parse_form, read_amendment, read_contract
from phyagentos.store.edits.reading import Line, Section, Sheet
from phyagentos.store.views.sessions import build_data

POSSIBLE = (
    "limits and priority of a pending session, 'state: cancelled' (with a line 'reason:'), or a new section "
    "'## <id>' with a YAML block 'contract:'"
)
_LIMITS = ("contract", "limits")
_PRIORITY = ("contract", "priority")
_Path = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Merge:
    """What an edited document asks for, in the order of its lines."""

    accepted: tuple[Accepted, ...]
    refused: tuple[Refused, ...]


def merge(
    edited: Sheet, base: Sheet, sessions: Mapping[SessionId, SessionStatus], source: str = "SESSIONS.md"
) -> Merge:
    """Merge one edited document; `base` is what was rendered at its sequence number, `sessions` the present."""
    accepted: list[Accepted] = []
    refused = list(_refuse_lines(_find_new(edited.head, base.head), "the text above the sessions"))
    known = {section.name: section for section in base.sections}
    changed = [section for section in edited.sections if not _is_as_rendered(section, known.get(section.name))]
    times = Counter(section.name for section in changed)
    for section in changed:
        if times[section.name] > 1:
            reason = f"two sections are called {section.name} and both differ from what was rendered"
            refused.append(_refuse(section, reason, "give the new one an id of its own"))
            continue
        merging = _SectionMerge(section, known.get(section.name), sessions, source)
        try:
            accepted += merging.run()
        except Impossible as error:
            refused.append(_refuse(section, error.reason, error.possible))
        except (TypeError, ValueError, OverflowError, RecursionError) as error:
            refused.append(_refuse(section, f"it holds a value that cannot be recorded: {error}", "another value"))
        refused += merging.refused
    return Merge(tuple(accepted), tuple(refused))


def _is_as_rendered(section: Section, base: Section | None) -> bool:
    if base is None or section.text == base.text:
        return base is not None
    words, rendered = ([text for _, text in each.prose] for each in (section, base))
    return section.yaml == base.yaml and words == rendered


class _SectionMerge:
    """One section that differs from what was rendered."""

    def __init__(
        self, section: Section, base: Section | None, sessions: Mapping[SessionId, SessionStatus], source: str
    ) -> None:
        self._section, self._base, self._sessions, self._source = section, base, sessions, source
        self._id = SessionId(section.name)
        self.refused: list[Refused] = []

    def run(self) -> list[Accepted]:
        """Entries to record; what cannot be is in `refused`."""
        section, base = self._section, self._base
        if section.yaml is None:
            if base is not None and not _find_new(section.prose, base.prose):
                return []  # its block was deleted
            raise Impossible("it has no YAML block that is closed", POSSIBLE)
        try:
            located = parse_form(section.yaml, self._source, section.yaml_line)
        except DefinitionError as error:
            raise Impossible("; ".join(map(str, error.problems)), "correct the YAML") from error
        if base is not None and self._id not in self._sessions:
            raise Impossible(f"session {self._id} is long over", "nothing; submit a new session")
        if base is not None and base.yaml is not None:
            extra = _find_new(section.prose, base.prose)
            accepted = self._amend(located, parse_form(base.yaml, self._source))
        else:
            extra = list(section.prose)
            accepted = self._submit(located)
        comments = _find_comments(section, base)
        self.refused += _refuse_lines([*extra, *comments], self._id)
        return accepted

    def _submit(self, located: Located) -> list[Accepted]:
        data = located.data if isinstance(located.data, dict) else {}
        others = [str(key) for key in data if key != "contract" and not (key == "state" and data[key] == "pending")]
        if others:
            place = f"{self._source}:{self._section.yaml_line}"
            raise Impossible(
                f"{place}: a new section has only 'contract', found {format_names(others)}",
                "delete these lines: they come from the journal",
            )
        if "contract" not in data:
            raise Impossible(f"{self._source}:{self._section.yaml_line}: found no 'contract'", POSSIBLE)
        try:
            contract = read_contract(located, ("contract",), self._id)
        except DefinitionError as error:
            raise Impossible("; ".join(map(str, error.problems)), "correct the contract") from error
        entry = plan_submit(contract, self._sessions)
        return [] if entry is None else [self._accept(entry, self._section.line, self._section.text, "submitted")]

    def _amend(self, located: Located, base: Located) -> list[Accepted]:
        """Every field that differs from the rendering, against the session as it stands."""
        theirs, before = dict(_flatten(located.data)), dict(_flatten(base.data))
        now = dict(_flatten(build_data(self._sessions[self._id])))
        changed = [path for path in theirs if path not in before or not _are_equal(theirs[path], before[path])]
        limits: dict[str, Any] = {}
        priority: int | None = None
        lines: list[int] = []
        accepted: list[Accepted] = []
        for path in changed:
            line = _find_line(located, path, self._section)
            if path == ("state",) and str(theirs[path]) in CANCELS:
                accepted += self._cancel(str(theirs.get(("reason",), "")), line)
            elif path == ("reason",) and str(theirs.get(("state",), "")) in CANCELS:
                continue  # recorded with the end that it explains
            elif path[:-1] == _LIMITS or path == _PRIORITY:
                value = theirs[path]
                if problem := self._find_obstacle(located, path, value, before.get(path), now.get(path)):
                    self._refuse_field(path, line, *problem)
                    continue
                lines.append(line)
                if path == _PRIORITY:
                    priority = value
                else:
                    limits[path[-1]] = float(value)
            else:
                self._refuse_field(path, line, *_explain_fixed(path))
        for path in _find_missing(before, theirs):
            self._refuse_field(path, self._section.line, "the line was deleted, which asks for nothing", POSSIBLE)
        if limits or priority is not None:
            accepted += self._change(Amendment(limits=limits, priority=priority), lines)
        return accepted

    def _cancel(self, reason: str, line: int) -> list[Accepted]:
        try:
            entry = plan_cancel(self._id, reason, self._sessions)
        except Impossible as error:
            self._refuse_field(("state",), line, error.reason, error.possible)
            return []
        return [] if entry is None else [self._accept(entry, line, self._get_text(line), "asked to end")]

    def _change(self, amendment: Amendment, lines: Sequence[int]) -> list[Accepted]:
        text = "\n".join(map(self._get_text, lines))
        try:
            entry = plan_amend(self._id, amendment, self._sessions)
        except Impossible as error:
            self._add_refusal(lines[0], error.reason, error.possible, text)
            return []
        amended = [f"{name} {value:g} s" for name, value in amendment.limits.items()]
        amended += [f"priority {amendment.priority}"] if amendment.priority is not None else []
        return [] if entry is None else [self._accept(entry, lines[0], text, ", ".join(amended))]

    def _find_obstacle(
        self, located: Located, path: _Path, value: Any, before: Any, now: Any
    ) -> tuple[str, str] | None:
        """Why a limit or the priority cannot become `value`, and what is possible; None when it can."""
        if path == _PRIORITY:
            if isinstance(value, bool) or not isinstance(value, int) or abs(value) > PRIORITY_MAX:
                return f"found {value!r}", f"a whole number up to {PRIORITY_MAX}"
        else:
            try:
                read_amendment(located, _LIMITS, {path[-1]: value}, None)
            except DefinitionError as error:
                known = format_names(Limits.__struct_fields__)
                return str(error.problems[0]), f"seconds, as a number; limits are {known}"
        if before is None or now is None or _are_equal(now, before) or _are_equal(now, value):
            return None
        reason = f"it was {before!r} where you began, is {now!r} by now, and you want {value!r}"
        return reason, "open the file again, and change it there if you still want to"

    def _accept(self, entry: Entry, line: int, text: str, summary: str) -> Accepted:
        return Accepted(entry=entry, line=line, summary=f"{self._id}: {summary}", text=text)

    def _refuse_field(self, path: _Path, line: int, reason: str, possible: str) -> None:
        name = ".".join(path) or "the block"
        self._add_refusal(line, f"{name}: {reason}", possible, self._get_text(line))

    def _add_refusal(self, line: int, reason: str, possible: str, text: str) -> None:
        self.refused.append(Refused(line=line, about=str(self._id), reason=reason, possible=possible, text=text))

    def _get_text(self, line: int) -> str:
        """The line; the whole section where the value goes on below it."""
        lines = self._section.text.split("\n")
        index = line - self._section.line
        following = lines[index + 1] if index + 1 < len(lines) else ""
        indent = len(lines[index]) - len(lines[index].lstrip())
        is_long = index == 0 or (bool(following.strip()) and len(following) - len(following.lstrip()) > indent)
        return self._section.text if is_long else lines[index]


def _flatten(data: Any, path: _Path = ()) -> Iterator[tuple[_Path, Any]]:
    """Every leaf with its path; lists and empty mappings are leaves."""
    if isinstance(data, dict) and data:
        for key, each in data.items():
            yield from _flatten(each, (*path, str(key)))
    else:
        yield path, data


def _are_equal(one: Any, other: Any) -> bool:
    """Whether two values are the same in YAML: true is not 1, but 60 is 60.0."""
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(map(_are_equal, one, other))
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_are_equal(one[key], other[key]) for key in one)
    return isinstance(one, bool) == isinstance(other, bool) and bool(one == other)


def _find_missing(before: Mapping[_Path, Any], theirs: Mapping[_Path, Any]) -> list[_Path]:
    """Fields that were rendered and are gone, unless a value above or below them was written instead."""
    replaced = {path[:length] for path in theirs for length in range(len(path) + 1)}
    return [
        path
        for path in before
        if path not in replaced and not any(path[:length] in theirs for length in range(len(path)))
    ]


def _find_line(located: Located, path: _Path, section: Section) -> int:
    for length in range(len(path), -1, -1):
        if mark := located.marks.get(path[:length]):
            return min(mark[0], section.line + section.text.count("\n") - 1)
    return section.yaml_line


def _find_new(lines: Sequence[Line], base: Sequence[Line]) -> list[Line]:
    """Lines that were not rendered."""
    left = Counter(text for _, text in base)
    found = []
    for number, text in lines:
        if left[text] > 0:
            left[text] -= 1
        else:
            found.append((number, text))
    return found


def _find_comments(section: Section, base: Section | None) -> list[Line]:
    rendered = set(base.yaml.split("\n")) if base is not None and base.yaml is not None else set()
    lines = enumerate((section.yaml or "").split("\n"), section.yaml_line)
    return [(number, line) for number, line in lines if "#" in line and line not in rendered and _has_comment(line)]


def _has_comment(line: str) -> bool:
    """Whether a line of YAML ends with a comment, as far as one line shows."""
    quote = ""
    for index, letter in enumerate(line):
        if quote:
            quote = "" if letter == quote and line[index - 1] != "\\" else quote
        elif letter in "'\"":
            quote = letter
        elif letter == "#" and (index == 0 or line[index - 1].isspace()):
            return True
    return False


def _explain_fixed(path: _Path) -> tuple[str, str]:
    if path == ("state",):
        return "a state follows from records, and a verdict from evidence", "state: cancelled"
    if path[:1] == ("contract",):
        hint = format_hint(path[-1], [*Limits.__struct_fields__, "limits", "priority"])
        return f"a contract stands as it was submitted. {hint}".rstrip(), POSSIBLE
    return "this comes from the journal", POSSIBLE


def _refuse(section: Section, reason: str, possible: str) -> Refused:
    return Refused(line=section.line, about=section.name, reason=reason, possible=possible, text=section.text)


def _refuse_lines(lines: Sequence[Line], about: str) -> list[Refused]:
    if not lines:
        return []
    lines = sorted(lines)
    text = "".join(f"{text}\n" for _, text in lines)
    reason = "words and comments are not kept, they are rendered anew"
    return [Refused(line=lines[0][0], about=about, reason=reason, possible=POSSIBLE, text=text)]
