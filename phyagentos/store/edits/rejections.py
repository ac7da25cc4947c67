"""SESSIONS.rejected.md: every edit that was not taken, word for word, with its place, the reason and what is possible.

It is only ever appended to, and durable before the edit is gone.
"""

import hashlib
import os
import re
from collections import deque
from collections.abc import Sequence
from pathlib import Path

from phyagentos.protocol.documents.markdown import flatten
from phyagentos.store.edits.changes import Refused
from phyagentos.store.segments import SystemIO, sync_folder

NOTES_SHOWN = 3
_HEAD = """# Refused edits

What was written into SESSIONS.md and was not taken, newest last: where, why, what is possible, and every word of it.
Nothing reads this file; delete it when you like.

"""


class Rejections:
    """Appends to one SESSIONS.rejected.md, which appears with the first refusal."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._known: set[bytes] = set()
        self._notes: deque[str] = deque(maxlen=NOTES_SHOWN)

    @property
    def notes(self) -> tuple[str, ...]:
        """One line for each of the latest refusals, for the head of SESSIONS.md."""
        return tuple(self._notes)

    def forget_notes(self) -> None:
        """Show none any more."""
        self._notes.clear()

    def append(self, refused: Sequence[Refused], source: str, at: str) -> list[Refused]:
        """Write refusals, in the order of their lines, durably; returns those that were not written before."""
        new = [each for each in refused if _hash(each) not in self._known]
        if not new:
            return []
        self._known |= {_hash(each) for each in new}
        text = "".join(_render(each, source, at) for each in new)
        is_first = not self._path.exists()
        head = _HEAD if is_first else ""
        fd = os.open(self._path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o644)
        with os.fdopen(fd, "ab") as file:
            file.write((head + text).encode("utf-8", "backslashreplace"))
            file.flush()
            os.fsync(file.fileno())
        if is_first:
            sync_folder(self._path.parent, SystemIO())
        for each in new:
            self._notes.append(
                f"`{source}:{each.line}` ({each.about}): {_shorten(each.reason)}. See {self._path.name}."
            )
        return new


def _hash(refused: Refused) -> bytes:
    words = "\0".join((refused.about, refused.reason, refused.text))
    return hashlib.blake2b(words.encode("utf-8", "backslashreplace"), digest_size=16).digest()


def format_refusal(refused: Refused, source: str) -> str:
    """One line: where, what, why, possible."""
    reason = flatten(refused.reason).rstrip(".")
    return f"{source}:{refused.line}: {refused.about}: {reason}. Possible: {refused.possible}."


def _render(refused: Refused, source: str, at: str) -> str:
    fence = "`" * max([4, *(len(run) + 1 for run in re.findall("`+", refused.text))])
    text = refused.text if refused.text.endswith("\n") else f"{refused.text}\n"
    return (
        f"## {at} {source}:{refused.line}\n\n"
        f"- **About:** {refused.about}\n"
        f"- **Refused:** {flatten(refused.reason).rstrip('.')}.\n"
        f"- **Possible:** {refused.possible}.\n\n"
        f"{fence}text\n{text}{fence}\n\n"
    )


def _shorten(text: str) -> str:
    words = flatten(text).rstrip(".")
    return words if len(words) <= 160 else f"{words[:157]}..."
