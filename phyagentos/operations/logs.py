"""What the processes of a run have printed, line by line."""

from collections.abc import Iterator
from pathlib import Path

import msgspec

from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.plain_text import clean
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.watch import POLL_S, Watch


class LogLine(msgspec.Struct, frozen=True, kw_only=True):
    """One line, clean for a terminal; `log` is `agent`, `watch`, `worker-TARGET` or `world-TARGET`."""

    log: str
    line: str


def iter_log_lines(workspace: Path, name: str = "", *, follows: bool = False) -> Iterator[LogLine]:
    """The whole lines of one log, or of all; with `follows`, without end, those that are written later.

    Raises DefinitionError `UNKNOWN_NAME`, `NOT_A_WORKSPACE`.
    """
    folder = Workspace.open(workspace).logs
    known = sorted(path.stem for path in folder.glob("*.log"))
    if name and name not in known:
        raise DefinitionError.unknown("file", str(folder), name, known)
    read: dict[Path, int] = {}
    with Watch([folder]) as watch:
        yield from _read_lines(folder, name or "*", read)
        while follows:
            watch.wait(POLL_S)
            yield from _read_lines(folder, name or "*", read)


def _read_lines(folder: Path, name: str, read: dict[Path, int]) -> Iterator[LogLine]:
    """Lines that were not `read` yet, in bytes by file."""
    for path in sorted(folder.glob(f"{name}.log")):
        with path.open("rb") as file:
            file.seek(read.get(path, 0))
            whole, newline, _ = file.read().rpartition(b"\n")
        read[path] = read.get(path, 0) + len(whole + newline)
        for line in whole.decode(errors="replace").splitlines():
            yield LogLine(log=path.stem, line=clean(line))
