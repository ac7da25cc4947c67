"""The inbox: a writer without this library drops one YAML file, one request; folders show what became of it.

It writes `inbox/tmp/<name>.yaml` and renames it into `inbox/new/`, as in a maildir. Once recorded, the file stands in
`inbox/done/`, or in `inbox/refused/` beside `<name>.reason.md`.
"""

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, format_names
from phyagentos.protocol.documents.markdown import write_anew
from phyagentos.protocol.documents.regular_files import open_regular, read_regular
from phyagentos.protocol.documents.schema import Located, validate
from phyagentos.protocol.sessions.session import SessionId, SessionStatus
from phyagentos.protocol.sessions.stop_signals import extend_name, list_waiting, move_aside
from phyagentos.store.admission import Entry
from phyagentos.store.edits import form
from phyagentos.store.edits.changes import plan_amend, plan_cancel, plan_submit
from phyagentos.store.edits.exchange import may_be_written

SETTLED_S = 0.5  # a file written straight into `new/` appears empty and grows
INBOX_MAX = 1 << 20  # bytes of a request
_EXAMPLE = """kind: cancel
session: tidy-7.red
reason: supper
"""


@dataclass(frozen=True, slots=True)
class Dropped:
    """One file that waits in `inbox/new/`."""

    path: Path

    def accept(self) -> None:
        """It was done, or stood already."""
        move_aside(self.path, self.path.parent.parent / "done")

    def refuse(self, reason: str) -> None:
        """It cannot be done; the reason is put beside it."""
        moved = move_aside(self.path, self.path.parent.parent / "refused")
        if moved is None:  # gone
            return
        kinds = format_names(form.REQUESTS)
        text = (
            f"# {self.path.name} was refused\n\n{reason}\n\nNothing was done. Correct it and drop it again. A request "
            f"is a YAML mapping with `kind` ({kinds}), for example:\n\n```yaml\n{_EXAMPLE}```\n"
        )
        reason_file = moved.with_name(extend_name(moved.name, ".reason.md"))
        write_anew(reason_file, text)


class Inbox:
    """The folder `inbox/` of a workspace; the clock is for files that are still being written."""

    def __init__(self, folder: Path, clock: Clock) -> None:
        self._new, self._clock = folder / "new", clock
        self._seen: dict[str, tuple[int, float]] = {}  # name -> size, and when it was first seen so

    def read_new(self) -> Iterator[Dropped]:
        """Files that are finished, by name; each is looked at when its turn comes."""
        paths = list_waiting(self._new)
        self._seen = {path.name: self._seen[path.name] for path in paths if path.name in self._seen}
        return (Dropped(path) for path in paths if self._is_finished(path))

    def _is_finished(self, path: Path) -> bool:
        try:
            fd, found = open_regular(path, follow=False)
        except OSError:
            return True  # unreadable, which is a reason to refuse it
        is_growing, size = may_be_written(fd), found.st_size
        os.close(fd)
        if size > INBOX_MAX or (is_growing is False and _is_yaml(path)):
            return True
        now_s = self._clock.now_s()
        if path.name not in self._seen or self._seen[path.name][0] != size:
            self._seen[path.name] = size, now_s
        return is_growing is not True and now_s - self._seen[path.name][1] >= SETTLED_S


def read_request(path: Path) -> tuple[form.Request, Located]:
    """A file's request, and the place of each part; raises DefinitionError with every problem at file:line:column."""
    try:
        located = _parse(path)
    except (OSError, UnicodeDecodeError) as error:
        raise DefinitionError.of("UNREADABLE_FILE", path.name, str(error)) from error
    data = located.data
    kind = data.get("kind") if isinstance(data, dict) else None
    if not isinstance(kind, str) or kind not in form.REQUESTS:
        found = repr(kind) if kind is not None else "no 'kind'"
        raise DefinitionError(located.unknown("UNKNOWN_REQUEST", ("kind",), str(kind), form.REQUESTS, found))
    return validate(form.REQUESTS[kind], located), located


def plan_request(path: Path, sessions: Mapping[SessionId, SessionStatus]) -> Entry | None:
    """The record that a file asks for; None when it is recorded already. The file's name is the default session id.

    Raises DefinitionError with every problem at file:line:column; Impossible when the state of the session forbids it.
    """
    request, located = read_request(path)
    match request:
        case form.SubmitRequest():
            id = str(request.contract.get("id") or path.stem)
            return plan_submit(form.read_contract(located, ("contract",), id), sessions)
        case form.AmendRequest():
            amendment = form.read_amendment(located, ("limits",), request.limits, request.priority)
            return plan_amend(SessionId(request.session), amendment, sessions)
        case form.CancelRequest():
            return plan_cancel(SessionId(request.session), request.reason, sessions)


def _is_yaml(path: Path) -> bool:
    """Whether it can be refused or done at once; what is no YAML yet may still grow."""
    try:
        return isinstance(_parse(path).data, dict)
    except (OSError, ValueError, DefinitionError):
        return False


def _parse(path: Path) -> Located:
    return form.parse_form(read_regular(path, INBOX_MAX, follow=False).decode("utf-8-sig"), path.name)
