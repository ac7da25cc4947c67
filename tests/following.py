"""Waiting for what other processes do: until a condition holds, or until a session has passed a state."""

from collections.abc import Callable, Iterable

from phyagentos.clock import SystemClock
from phyagentos.store.ledger import Ledger
from phyagentos.store.records import Record

LIMIT_S = 60.0  # generous: what is awaited takes seconds on an idle machine
CLOCK = SystemClock()


def wait_until(is_so: Callable[[], object], awaited: str = "it", limit_s: float = LIMIT_S) -> None:
    """Look again and again. What is looked for must stay: a state that may be over is awaited by `Followed`."""
    deadline_s = CLOCK.now_s() + limit_s
    while not is_so():
        assert CLOCK.now_s() < deadline_s, f"{awaited} did not come within {limit_s:g} s"
        CLOCK.sleep(0.01)


class Followed:
    """A journal as it grows: its fold, and every record, so that a state is seen however short it lasted."""

    def __init__(self, read_new: Callable[[], Iterable[Record]]) -> None:
        self.ledger, self.records = Ledger(), []
        self._read_new = read_new

    def poll(self, id: str) -> str:
        """The state of a session now; empty when there is no such session."""
        for record in self._read_new():
            self.ledger.apply(record)
            self.records.append(record)
        return self.ledger.sessions[id].state if id in self.ledger.sessions else ""

    def events(self, id: str) -> list[str]:
        return [record.ev for record in self.records if record.id == id]

    def wait_for(self, id: str, state: str, patience_s: float = LIMIT_S) -> str:
        """Follow until a session is, or has been, in a state."""

        def has_passed() -> bool:
            return self.poll(id) == state or any(each.id == id and each.to == state for each in self.records)

        wait_until(has_passed, f"{id} {state}, with {self.events(id)},", patience_s)
        return state
