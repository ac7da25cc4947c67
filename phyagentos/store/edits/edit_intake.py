"""Takes edits in: SESSIONS.md and the inbox become records, SESSIONS.rejected.md or `inbox/refused/`."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.sessions.lifecycle import Fenced, IllegalTransition, Side
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.admission import Entry, IllegalEvent
from phyagentos.store.edits.changes import Accepted, Impossible, Refused
from phyagentos.store.edits.inbox import Inbox, plan_request
from phyagentos.store.edits.merge import Merge, merge
from phyagentos.store.edits.reading import decode, read_sheet
from phyagentos.store.edits.rejections import Rejections
from phyagentos.store.edits.shared_file import SharedFile
from phyagentos.store.journal import Journal
from phyagentos.store.views.history import History

OPERATOR = "operator"  # who wrote a record that came from an edit
NOTES_S = 600.0  # a refusal stands at the head of SESSIONS.md for so long
SECTIONS_MAX = 10_000  # that one edit may add
INBOX_S = 0.1  # for requests of the inbox in a turn of the watchdog; the rest has the next one
_REFUSALS = (IllegalTransition, Fenced, IllegalEvent, DefinitionError, ValueError, TypeError, OverflowError)


class EditIntake:
    """Takes edits of one workspace in; `adopts`: it also finishes what ended processes left half done."""

    def __init__(self, workspace: Workspace, clock: Clock, *, adopts: bool = True, durable: bool = True) -> None:
        self.file = SharedFile(workspace.sessions_document, workspace.edits, clock, on_unfit=self._refuse_unfit)
        self._workspace, self._clock, self._durable = workspace, clock, durable
        self._operator: Journal | None = None  # opened with the first edit: most runs see none
        self._source = workspace.sessions_document.name
        self._rejections = Rejections(workspace.rejected_document)
        self._inbox = Inbox(workspace.inbox, clock)
        self._noted_at_s = 0.0
        if adopts:
            self.file.adopt()

    @property
    def notes(self) -> Sequence[str]:
        """One line for each edit that was refused lately."""
        if self._rejections.notes and self._clock.now_s() - self._noted_at_s > NOTES_S:
            self._rejections.forget_notes()
        return self._rejections.notes

    def close(self) -> None:
        """Close the files."""
        self.file.close()
        if self._operator is not None:
            self._operator.close()

    def take(self, history: History, *, at_once: bool = False) -> bool:
        """Deal with everything that arrived and bring the history up to date; whether anything was recorded or refused.

        `at_once` is that of `SharedFile.take`. After an ExecutionError of the journal, the rest stays where it is.
        """
        is_new = any(each.accepted or each.refused for each in self.take_file(history, at_once=at_once))
        return self._take_inbox(history) or is_new

    def take_file(self, history: History, *, at_once: bool = False) -> list[Merge]:
        """As `take`, of SESSIONS.md alone: what became of each version that an editor left there."""
        results: list[Merge] = []

        def handle(data: bytes, is_whole: bool) -> None:
            results.append(self.take_text(decode(data), history, is_whole=is_whole))

        self.file.take(handle, at_once=at_once)
        return results

    def take_text(self, text: str, history: History, *, is_whole: bool = True) -> Merge:
        """Merge one edited document and record what it asks for; `is_whole`: its editor finished it.

        Of what was refused, only that which no earlier save of the same text was refused for is returned.
        """
        try:
            return self._merge_text(text, history, self._source, is_whole=is_whole)
        except ExecutionError:
            raise
        except Exception as error:  # no text may end the process that supervises
            refused = _refuse_whole(text, _format_failure(error), also=", and report this")
            return Merge((), tuple(self._reject([refused], self._source)))

    def _merge_text(self, text: str, history: History, source: str, *, is_whole: bool) -> Merge:
        history.read_new()
        sheet = read_sheet(text)
        page = history.find_page(sheet.view) if sheet.view is not None else None
        if page is None:
            if not text.strip():
                return Merge((), ())
            unknown = _refuse_whole(text, _explain_unknown(sheet.view, history.ledger.seq))
            return Merge((), tuple(self._reject([unknown], source)))
        base = history.render(page)
        if not is_whole:
            return Merge((), tuple(self._reject(_refuse_unfinished(text, base), source)))
        before = read_sheet(base)
        if len(sheet.sections) - len(before.sections) > SECTIONS_MAX:
            many = f"it has {len(sheet.sections)} sections, {len(before.sections)} of them as rendered"
            return Merge((), tuple(self._reject([_refuse_whole(text, many, also=f", {SECTIONS_MAX} at once")], source)))
        merged = merge(sheet, before, history.ledger.sessions, source)
        accepted, late = [], []
        for change in merged.accepted:
            if reason := self._find_refusal(change):
                late.append(_refuse_late(change, reason))
            else:
                accepted.append(change)
        history.read_new()
        refused = sorted([*merged.refused, *late], key=lambda each: each.line)
        return Merge(tuple(accepted), tuple(self._reject(refused, source)))

    def _take_inbox(self, history: History) -> bool:
        begin_s, is_new = self._clock.now_s(), False
        for file in self._inbox.read_new():
            is_new = True
            history.read_new()
            try:
                entry = plan_request(file.path, history.ledger.sessions)
                if entry is not None:
                    self._commit(entry)
            except ExecutionError:
                raise
            except (Impossible, *_REFUSALS) as error:
                file.refuse(str(error))
            except Exception as error:  # as in `take_text`
                file.refuse(_format_failure(error))
            else:
                file.accept()
            if self._clock.now_s() - begin_s > INBOX_S:
                break
        if is_new:
            history.read_new()
        return is_new

    def _commit(self, entry: Entry) -> None:
        if self._operator is None:
            self._operator = Journal(
                self._workspace.root, side=Side.OPERATOR, by=OPERATOR, clock=self._clock, durable=self._durable
            )
        self._operator.commit([entry])

    def _find_refusal(self, change: Accepted) -> str:
        """Record it; why not, when the journal does not take it."""
        try:
            self._commit(change.entry)
        except _REFUSALS as error:
            return str(error) or type(error).__name__
        return ""

    def _refuse_unfit(self, path: Path, reason: str) -> None:
        self._reject([_refuse_whole("", f"{reason}; it is kept in {path}")], self._source)

    def _reject(self, refused: Sequence[Refused], source: str) -> list[Refused]:
        new = self._rejections.append(refused, source, self._clock.wall_iso())
        if new:
            self._noted_at_s = self._clock.now_s()
        return new


def _refuse_whole(text: str, reason: str, line: int = 1, also: str = "") -> Refused:
    possible = f"make the same change in the present SESSIONS.md{also}"
    return Refused(line=line, about="the whole file", reason=reason, possible=possible, text=text)


def _explain_unknown(view: int | None, seq: int) -> str:
    if view is None:
        return (
            "its first lines do not name the rendering that it was made from ('view: <number>' between two lines '---')"
        )
    return f"the journal does not show what was rendered at record {view}; it stands at {seq}"


def _format_failure(error: Exception) -> str:
    return f"this program failed on it ({type(error).__name__}: {error})"


def _refuse_unfinished(text: str, base: str) -> list[Refused]:
    """A save that its editor gave up: what it added, if anything; the missing rest asks for nothing."""
    left = Counter(line.rstrip() for line in base.split("\n"))
    lines = text.split("\n")
    new = []
    for number, line in enumerate(lines[:-1], 1):  # the last one may be half a line
        if line.strip() and left[line.rstrip()] <= 0:
            new.append(number)
        left[line.rstrip()] -= 1
    if not new and any(each.startswith(lines[-1]) for each in left):
        return []
    reason = "the file ends before its end mark, so the save was not finished"
    return [_refuse_whole(text, reason, line=new[0] if new else len(lines))]


def _refuse_late(change: Accepted, reason: str) -> Refused:
    possible = "look at the session as it stands now, and decide anew"
    return Refused(line=change.line, about=change.entry.id, reason=reason, possible=possible, text=change.text)
