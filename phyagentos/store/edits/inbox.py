"""The inbox: a writer without this library drops one YAML file, one request; folders show what became of it.

It writes `inbox/tmp/<name>.yaml` and renames it into `inbox/new/`, as in a maildir. Once recorded, the file stands in
`inbox/done/`, or in `inbox/refused/` beside `<name>.reason.md`.
"""

import os
from collections.abc import Callable
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, ExecutionError, format_names
from phyagentos.protocol.documents.markdown import write_anew
from phyagentos.protocol.documents.regular_files import open_regular, read_regular
from phyagentos.protocol.documents.schema import Located
from phyagentos.protocol.documents.struct_schema import convert_located
from phyagentos.protocol.sessions.stop_signals import extend_name, list_waiting, move_aside
from phyagentos.store.edits import request_form as form
from phyagentos.store.edits.rejections import describe_failure
from phyagentos.store.shared_file import may_be_written

SETTLED_S = 0.5  # a file written straight into `new/` appears empty and grows
TURN_S = 0.1  # for requests in a turn of the watchdog; the rest has the next one
INBOX_MAX = 1 << 20  # bytes of a request
_EXAMPLE = """kind: cancel
session: tidy-7.red
reason: supper
"""


class Inbox:
    """The folder `inbox/` of a workspace; the clock is for files that are still being written."""

    def __init__(self, folder: Path, clock: Clock) -> None:
        self._folder, self._clock = folder, clock
        self._seen: dict[str, float] = {}  # name -> when it was first seen, and was unfinished

    def take(self, record: Callable[[Path], None]) -> bool:
        """Call `record` with each finished file, by name, and put it aside; whether there was any.

        What it raises refuses the file, except an ExecutionError, which leaves it and the rest where they are.
        """
        begin_s, taken = self._clock.now_s(), 0
        paths = list_waiting(self._folder / "new")
        self._seen = {path.name: self._seen[path.name] for path in paths if path.name in self._seen}
        for path in filter(self._is_finished, paths):
            try:
                record(path)
            except ExecutionError:
                raise
            except Exception as error:  # no file may end the process that supervises
                self._refuse(path, describe_failure(error))
            else:
                move_aside(path, self._folder / "done")
            taken += 1
            if self._clock.now_s() - begin_s > TURN_S:
                break
        return taken > 0

    def _refuse(self, path: Path, reason: str) -> None:
        moved = move_aside(path, self._folder / "refused")
        if moved is None:  # gone
            return
        text = (
            f"# {path.name} was refused\n\n{reason}\n\nNothing was done. Correct it and drop it again. A request is a "
            f"YAML mapping with `kind` ({format_names(form.REQUESTS)}), for example:\n\n```yaml\n{_EXAMPLE}```\n"
        )
        write_anew(moved.with_name(extend_name(moved.name, ".reason.md")), text)

    def _is_finished(self, path: Path) -> bool:
        try:
            fd, found = open_regular(path, follow=False)
        except OSError:
            return True  # unreadable, which is a reason to refuse it
        is_written = may_be_written(fd)
        os.close(fd)
        if found.st_size > INBOX_MAX or (is_written is False and _is_yaml(path)):
            return True
        now_s = self._clock.now_s()
        return is_written is not True and now_s - self._seen.setdefault(path.name, now_s) >= SETTLED_S


def read_request(path: Path) -> tuple[form.Request, Located]:
    """A file's request, and the place of each part; raises DefinitionError with every problem at file:line:column."""
    try:
        located = _parse(path)
    except (OSError, UnicodeDecodeError) as error:
        raise DefinitionError.of("UNREADABLE_FILE", path.name, str(error)) from error
    kind = located.data.get("kind") if isinstance(located.data, dict) else None
    if not isinstance(kind, str) or kind not in form.REQUESTS:
        found = repr(kind) if kind is not None else "no 'kind'"
        raise DefinitionError(located.unknown("request", ("kind",), str(kind), form.REQUESTS, found))
    return convert_located(form.REQUESTS[kind], located), located


def _is_yaml(path: Path) -> bool:
    """Whether it can be refused or done at once; what is no YAML yet may still grow."""
    try:
        return isinstance(_parse(path).data, dict)
    except (OSError, ValueError, DefinitionError):
        return False


def _parse(path: Path) -> Located:
    return form.parse_form(read_regular(path, INBOX_MAX, follow=False).decode("utf-8-sig"), path.name)
