"""SESSIONS.rejected.md: every edit that was not taken, word for word, with its place, the reason and what is possible.

It is only ever appended to, and durable before the edit is gone.
"""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from phyagentos.errors import PhyAgentOSError
from phyagentos.protocol.documents.markdown import flatten
from phyagentos.store.segments import SystemIO, sync_folder

_HEAD = """# Refused edits

What was written into SESSIONS.md and was not taken, newest last: where, why, what is possible, and every word of it.
Nothing reads this file; delete it when you like.

"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Refused:
    """An edit that was not taken.

    Attributes:
        line: Of the edited file, counted from 1.
        text: As it was written, word for word.
    """

    line: int = field(compare=False)
    about: str
    reason: str
    possible: str
    text: str

    def __str__(self) -> str:
        """One line: where, what, why, possible."""
        return f"{self.line}: {self.about}: {flatten(self.reason).rstrip('.')}. Possible: {self.possible}."


class Rejections:
    """Appends to one SESSIONS.rejected.md, which appears with the first refusal."""

    def __init__(self, path: Path, source: str) -> None:
        self._path, self._source = path, source
        self._known: set[int] = set()

    def append(self, refused: Sequence[Refused], at: str) -> list[Refused]:
        """Write refusals, in the order of their lines, durably; returns those that were not written before."""
        new = [each for each in sorted(refused, key=lambda each: each.line) if hash(each) not in self._known]
        if not new:
            return []
        is_first = not self._path.exists()
        text = "".join([_HEAD if is_first else "", *(self._render(each, at) for each in new)])
        with self._path.open("ab") as file:
            file.write(text.encode("utf-8", "backslashreplace"))
            file.flush()
            os.fsync(file.fileno())
        if is_first:
            sync_folder(self._path.parent, SystemIO())
        self._known.update(map(hash, new))
        return new

    def _render(self, refused: Refused, at: str) -> str:
        fence = "`" * max([4, *(len(run) + 1 for run in re.findall("`+", refused.text))])
        return (
            f"## {at} {self._source}:{refused.line}\n\n"
            f"- **About:** {refused.about}\n"
            f"- **Refused:** {flatten(refused.reason).rstrip('.')}.\n"
            f"- **Possible:** {refused.possible}.\n\n"
            f"{fence}text\n{refused.text.rstrip()}\n{fence}\n\n"
        )


def describe_failure(error: Exception) -> str:
    """Why a request was not recorded, for people."""
    is_expected = isinstance(error, PhyAgentOSError | ValueError | TypeError | OverflowError)
    return str(error) if is_expected else f"this program failed on it ({type(error).__name__}: {error})"
