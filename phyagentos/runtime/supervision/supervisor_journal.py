"""The watchdog's side of the journal: one ledger for all its parts, and the records that it adds."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager

import msgspec

from phyagentos.errors import Problem
from phyagentos.protocol.sessions.lifecycle import Fenced, IllegalTransition, SessionState
from phyagentos.protocol.sessions.session import SessionId, SessionStatus
from phyagentos.store.journal import Entry, Journal, Record
from phyagentos.store.ledger import Ledger

TRIES = 5  # at a record that another writer makes out of date


class _Try(AbstractContextManager[None]):
    """Notes whether another writer was faster, and lets only the last try fail of that."""

    def __init__(self, *, is_last: bool) -> None:
        self._is_last, self.is_overtaken = is_last, False

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> bool:
        self.is_overtaken = kind is not None and issubclass(kind, IllegalTransition | Fenced)
        return self.is_overtaken and not self._is_last


class SupervisorJournal:
    """Follows the journal, opened for the runtime side, and records in it.

    The ledger holds everything up to the latest record that was followed. `on_pending` is called with every session
    that begins to wait, and with one that was amended while it waits; `on_record` with every record, once it is
    applied.
    """

    def __init__(
        self,
        journal: Journal,
        ledger: Ledger,
        on_pending: Callable[[SessionStatus], None],
        on_record: Callable[[Record], None] = lambda _: None,
    ) -> None:
        self._journal = journal
        self._on_pending, self._on_record = on_pending, on_record
        self.ledger = ledger

    def follow(self, *, looks: bool = True) -> None:
        """Apply new records; without `looks`, only what a commit here has found and added."""
        for record in self._journal.read_new(looks=looks):
            self.ledger.apply(record)
            self._on_record(record)
            if record.to == SessionState.PENDING:
                status = self.ledger.sessions.get(SessionId(record.id))
                if status is not None:
                    self._on_pending(status)

    def record(self, *entries: Entry, durable: bool = True) -> None:
        """Add a batch.

        Raises:
            IllegalTransition, Fenced: Another writer was faster; nothing was recorded.
        """
        self._journal.commit(entries, durable=durable)
        self.follow(looks=False)

    def sync(self) -> None:
        """Wait until all records are on the disk."""
        self._journal.sync()

    def try_commit(self, entry: Entry) -> None:
        """Record an entry unless another writer was faster; then the next turn of the loop decides anew."""
        try:
            self.record(entry)
        except IllegalTransition:
            self.follow()

    def iter_tries(self) -> Iterator[AbstractContextManager[None]]:
        """Tries of an act, one after another as long as another writer changes the session before it is recorded.

        Raises:
            IllegalTransition, Fenced: At the last try.
        """
        for number in range(1, TRIES + 1):
            yield (attempt := _Try(is_last=number == TRIES))
            if not attempt.is_overtaken:
                return
            self.follow()

    def get_state(self, session: SessionId) -> SessionState:
        """State of a session."""
        status = self.ledger.sessions.get(session)
        return SessionState(status.state) if status is not None else SessionState.CANCELLED  # forgotten: long over

    def open_check(self, session: SessionId, epoch: int) -> tuple[Entry, ...]:
        """The claim under this epoch and its check, as far as they are still to be recorded."""
        state = self.get_state(session)
        claim = (Entry(session, "claim", epoch=epoch - 1),) if state is SessionState.PENDING else ()
        is_open = state in {SessionState.PENDING, SessionState.CLAIMED}
        return (*claim, Entry(session, "check", epoch=epoch)) if is_open else ()

    def open_halt(self, session: SessionId, epoch: int) -> tuple[Entry, ...]:
        """The halt of a running session; empty once it is recorded."""
        return (Entry(session, "halt", epoch=epoch),) if self.get_state(session) is SessionState.RUNNING else ()


def make_rejection(session: SessionId, *problems: Problem, epoch: int | None = None) -> Entry:
    """The record of a rejection: a sentence for people, the problems for programs."""
    return make_entry(
        session, "reject", epoch, reason="; ".join(map(str, problems)), problems=msgspec.to_builtins(problems)
    )


def make_entry(session: SessionId, trigger: str, epoch: int | None = None, **body: object) -> Entry:
    """A record of one session; empty fields are left out of its body."""
    return Entry(session, trigger, {name: value for name, value in body.items() if value != ""} or None, epoch)
