"""Takes edits in: SESSIONS.md and the inbox become records, SESSIONS.rejected.md or `inbox/refused/`."""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.errors import ExecutionError
from phyagentos.protocol.documents.markdown import flatten
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Session, SessionId
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.admission import Entry
from phyagentos.store.edits.inbox import Inbox, read_request
from phyagentos.store.edits.rejections import Refused, Rejections, describe_failure
from phyagentos.store.edits.request_form import AmendRequest, Request, plan, refuse_conflict
from phyagentos.store.edits.sections import Edit, compare, find_view
from phyagentos.store.journal import Journal
from phyagentos.store.shared_file import SharedFile, decode
from phyagentos.store.views.page_history import History

OPERATOR = "operator"  # who wrote a record that came from an edit
NOTES_S = 600.0  # a refusal stands at the head of SESSIONS.md for so long
NOTES_SHOWN = 3
NOTE_MAX = 200  # letters


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one edited document: records, and what was refused and never was before."""

    recorded: Sequence[Entry] = ()
    refused: Sequence[Refused] = ()

    def __bool__(self) -> bool:
        """Whether it asked for anything."""
        return bool(self.recorded or self.refused)


class EditIntake:
    """Takes edits of one workspace in; `adopts`: it also finishes what ended processes left half done."""

    def __init__(self, workspace: Workspace, clock: Clock, *, adopts: bool = True, durable: bool = True) -> None:
        self.file = SharedFile(workspace.sessions_document, workspace.edits, clock, on_unfit=self._refuse_unfit)
        self._workspace, self._clock, self._durable = workspace, clock, durable
        self._operator: Journal | None = None  # opened with the first edit: most runs see none
        self._source = workspace.sessions_document.name
        self._rejections = Rejections(workspace.rejected_document, self._source)
        self._inbox = Inbox(workspace.inbox, clock)
        self._notes: deque[tuple[float, str]] = deque(maxlen=NOTES_SHOWN)
        if adopts:
            self.file.adopt()

    @property
    def notes(self) -> Sequence[str]:
        """One line for each edit that was refused lately."""
        begin_s = self._clock.now_s() - NOTES_S
        return [note for at_s, note in self._notes if at_s >= begin_s]

    def close(self) -> None:
        """Close the files."""
        self.file.close()
        if self._operator is not None:
            self._operator.close()

    def take(self, history: History, *, at_once: bool = False) -> bool:
        """Deal with everything that arrived and bring the history up to date; whether anything was recorded or refused.

        `at_once` is that of `SharedFile.take`. After an ExecutionError of the journal, the rest stays where it is.
        """
        is_edited = any(self.take_file(history, at_once=at_once))

        def record(path: Path) -> None:
            history.read_new()
            request, located = read_request(path)
            self._commit(plan(request, located, path.stem, history.ledger.sessions))

        is_requested = self._inbox.take(record)
        history.read_new()
        return is_edited or is_requested

    def take_file(self, history: History, *, at_once: bool = False) -> list[Outcome]:
        """As `take`, of SESSIONS.md alone: what became of each version that an editor left there."""
        outcomes: list[Outcome] = []

        def handle(data: bytes, is_whole: bool) -> None:
            outcomes.append(self.take_text(decode(data), history, is_whole=is_whole))

        self.file.take(handle, at_once=at_once)
        return outcomes

    def take_text(self, text: str, history: History, *, is_whole: bool = True) -> Outcome:
        """Record what one edited document asks for, and keep the rest; `is_whole`: its editor finished it."""
        history.read_new()
        recorded: list[Entry] = []
        try:
            refused = self._read(text, history, recorded, is_whole=is_whole)
        except ExecutionError:
            raise
        except Exception as error:  # no text may end the process that supervises
            refused = [_refuse_whole(text, describe_failure(error))]
        history.read_new()
        return Outcome(recorded, self._reject(refused))

    def _read(self, text: str, history: History, recorded: list[Entry], *, is_whole: bool) -> list[Refused]:
        """Add what is recorded to `recorded`, and return what is refused."""
        view = find_view(text)
        page = history.find_page(view) if view is not None else None
        if page is None:
            which = f"what was rendered at record {view}" if view is not None else "which rendering it was made from"
            reason = (
                f"the journal, at record {history.ledger.seq}, does not show {which} ('view: N' in the first lines)"
            )
            return [_refuse_whole(text, reason)] if text.strip() else []
        base = history.render(page)
        if not is_whole:  # its editor gave up
            reason = "the file ends before its end mark, so the save was not finished"
            return [] if base.startswith(text.rstrip()) else [_refuse_whole(text, reason)]
        shown = {status.contract.id: status.contract for status in page.shown}
        edits = compare(text, base, self._source)
        for edit in edits:
            for request in edit.requests:
                try:
                    recorded += self._record(request, edit, shown, history)
                except ExecutionError:
                    raise
                except Exception as error:  # as in `take_text`
                    edit.reasons.append(describe_failure(error))
        return [refused for edit in edits if (refused := edit.find_refused()) is not None]

    def _record(
        self, request: Request, edit: Edit, shown: Mapping[SessionId, Session], history: History
    ) -> list[Entry]:
        sessions = history.ledger.sessions
        entry = plan(request, edit.located, edit.section.name, sessions)
        if entry is not None and isinstance(request, AmendRequest) and request.session in sessions:
            refuse_conflict(request, sessions[request.session].contract, shown[request.session])
        return self._commit(entry)

    def _commit(self, entry: Entry | None) -> list[Entry]:
        if entry is None:  # it is recorded already
            return []
        if self._operator is None:
            self._operator = Journal(
                self._workspace.root, side=Side.OPERATOR, by=OPERATOR, clock=self._clock, durable=self._durable
            )
        self._operator.commit([entry])
        return [entry]

    def _refuse_unfit(self, path: Path, reason: str) -> None:
        self._reject([_refuse_whole("", f"{reason}; it is kept in {path}")])

    def _reject(self, refused: Sequence[Refused]) -> list[Refused]:
        new = self._rejections.append(refused, self._clock.wall_iso())
        for each in new:
            words = f"({each.about}): {flatten(each.reason).rstrip('.')}"
            note = f"`{self._source}:{each.line}` {words[:NOTE_MAX]}. See {self._workspace.rejected_document.name}."
            self._notes.append((self._clock.now_s(), note))
        return new


def edit_by_hand(
    edits: EditIntake, history: History, change: Callable[[str], str], *, on_wait: Callable[[], None]
) -> Outcome:
    """Let a person change a fresh rendering, which is not replaced meanwhile, and publish the result.

    What came out with the publishing may be an edit that was saved without this. `change` gets the text and returns
    the edited one; what it raises changes nothing.
    """
    try:
        with edits.file.hold(wait=False):
            pass
    except BlockingIOError:
        on_wait()
    with edits.file.hold(wait=True):
        history.read_new()
        outcome = edits.take_text(change(history.render(history.build_page())), history)
    for _ in range(2):
        edits.file.put(history.render(history.build_page(edits.notes)))
        if not any(edits.take_file(history, at_once=True)):
            break
    return outcome


def _refuse_whole(text: str, reason: str) -> Refused:
    possible = "make the same change in the present SESSIONS.md"
    return Refused(line=1, about="the whole file", reason=reason, possible=possible, text=text)
