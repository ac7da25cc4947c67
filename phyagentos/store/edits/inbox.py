"""The inbox: a writer without this library drops one YAML file, one request; folders show what became of it.

It writes `inbox/tmp/<name>.yaml` and renames it into `inbox/new/`, as in a maildir. Once recorded, the file stands in
`inbox/done/`, or in `inbox/refused/` beside `<name>.reason.md`.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, format_names
from phyagentos.protocol.documents.markdown import write_anew
from phyagentos.protocol.documents.schema import Located, validate
from phyagentos.protocol.sessions.session import SessionId, SessionStatus
from phyagentos.protocol.sessions.stop_signals import extend_name, move_aside
from phyagentos.store.admission import Entry
from phyagentos.store.edits import form
from phyagentos.store.edits.changes import plan_amend, plan_cancel, plan_submit
from phyagentos.store.edits.exchange import may_be_written

SETTLED_S = 0.5  # a file written straight into `new/` appears empty and grows
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
        if moved is None:  # gone, or a folder
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

    def read_new(self) -> list[Dropped]:
        """Files that are finished, by name."""
        try:
            with os.scandir(self._new) as entries:
                names = sorted(each.name for each in entries if not each.name.startswith(".") and each.is_file())
        except FileNotFoundError:
            return []
        self._seen = {name: seen for name, seen in self._seen.items() if name in names}
        return [Dropped(self._new / name) for name in names if self._is_finished(name)]

    def _is_finished(self, name: str) -> bool:
        path = self._new / name
        try:
            with path.open("rb") as file:
                is_growing = may_be_written(file.fileno())
                size = os.fstat(file.fileno()).st_size
        except OSError:
            return True  # unreadable, which is a reason to refuse it
        if is_growing is False and _is_yaml(path):
            return True
        now_s = self._clock.now_s()
        if name not in self._seen or self._seen[name][0] != size:
            self._seen[name] = size, now_s
        return is_growing is not True and now_s - self._seen[name][1] >= SETTLED_S


def read_request(path: Path) -> tuple[form.Request, Located]:
    """A file's request, and the place of each part; raises DefinitionError with every problem at file:line:column."""
    try:
        if path.is_symlink():  # what it leads to must not show in the reason
            raise OSError("a link")
        located = form.parse_form(path.read_text(encoding="utf-8-sig"), path.name)
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

    Raises:
        DefinitionError: With every problem, each at file:line:column.
        Impossible: When the state of the session forbids it.
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
        return isinstance(form.parse_form(path.read_text(encoding="utf-8-sig"), path.name).data, dict)
    except (OSError, ValueError, DefinitionError):
        return False
