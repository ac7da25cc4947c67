"""Edits of RUNTIME_SIGNAL.md: an added section `## Request` becomes a file of `signals/`; other changes are lost."""

import os
import re
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.protocol.documents.document import iter_blocks
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.edits.reading import decode
from phyagentos.store.edits.shared_file import SharedFile
from phyagentos.store.views.sessions import END_MARK

REQUEST = "Request"  # heading of a request
_REQUEST = re.compile(rf"^## {REQUEST}[ \t]*$", re.MULTILINE)
_NEXT = re.compile(r"^## ", re.MULTILINE)
_AT = re.compile(r"^at: \S.*$", re.MULTILINE)


class SignalIntake:
    """Takes requests out of one RUNTIME_SIGNAL.md."""

    def __init__(self, workspace: Workspace, clock: Clock) -> None:
        self._file = SharedFile(workspace.runtime_signal, workspace.edits / "signals", clock)
        self._file.adopt()
        self._signals, self._clock = workspace.signals, clock
        self._known: set[tuple[str, str]] = set()
        self._number = 0

    def put(self, text: str) -> bool:
        """Put a rendering there; see `SharedFile.put`."""
        return self._file.put(text)

    def is_touched(self) -> bool:
        """Whether the document was changed since it was put there."""
        return self._file.is_touched()

    def take(self, *, at_once: bool = False) -> None:
        """Turn the requests of every edited version into files; see `SharedFile.take`."""
        self._file.take(self._handle, at_once=at_once)

    def close(self) -> None:
        """Close the files."""
        self._file.close()

    def _handle(self, data: bytes, _is_whole: bool) -> None:
        text = decode(data)
        shown = _AT.search(text)
        for request in find_requests(text):
            edit = (shown[0] if shown else "", request)  # a second save of the same text asks for nothing new
            if edit not in self._known:
                self._known.add(edit)
                self._drop(request)

    def _drop(self, request: str) -> Path:
        """One request as a file; it appears whole or not at all."""
        stamp = self._clock.wall_iso().replace(":", "").replace(".", "")
        while True:
            self._number += 1
            name = f"{stamp}-{os.getpid()}-edit-{self._number}.yaml"
            path = self._signals / name
            if not path.exists():
                break
        self._signals.mkdir(parents=True, exist_ok=True)
        temporary = self._signals.parent / f".{name}.tmp"
        temporary.write_text(request, encoding="utf-8", errors="backslashreplace")
        return temporary.replace(path)


def find_requests(text: str) -> list[str]:
    """The YAML of each `## Request` section; all of its text where it holds no complete block."""
    requests = []
    for match in _REQUEST.finditer(text):
        following = _NEXT.search(text, match.end())
        section = text[match.end() : following.start() if following else len(text)].replace(END_MARK, "")
        block = next(iter_blocks(f"## {REQUEST}\n{section}"), None)
        requests.append(block.yaml if block is not None else f"{section.strip()}\n")
    return requests
