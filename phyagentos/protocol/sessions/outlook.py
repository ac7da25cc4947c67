"""What will probably be asked of a target next, so that it can be checked before it is asked: `.cache/outlook/`.

Upstream: the agent, while a session runs on which the next one depends. Downstream: the runtime, when it has nothing
else to do on that target. It is a guess: nothing is recorded of it, and what was checked is used only if exactly that
is submitted. So the file is written in place and never waited for; one that is missing, torn or old costs the time of
a check, and nothing else.
"""

import contextlib
import os
from pathlib import Path

import msgspec

from phyagentos.protocol.sessions.session import Session

_DECODER = msgspec.json.Decoder(Session)


class Outlook:
    """The guesses of one workspace.

    Args:
        cache: Folder for what may be lost.
    """

    def __init__(self, cache: Path) -> None:
        self._folder = cache / "outlook"

    def expect(self, session: Session) -> None:
        """Say what will probably be asked next of the session's target."""
        data = msgspec.json.encode(session)
        with contextlib.suppress(OSError):  # a full disk: then it is checked when it is asked
            fd = self._open(session.target)
            try:
                os.truncate(fd, os.write(fd, data))
            finally:
                os.close(fd)

    def find(self, target: str) -> Session | None:
        """What will probably be asked next of a target; None when nobody knows."""
        try:
            return _DECODER.decode((self._folder / f"{target}.json").read_bytes())
        except (OSError, msgspec.MsgspecError):
            return None

    def _open(self, target: str) -> int:
        path, flags = self._folder / f"{target}.json", os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC
        try:
            return os.open(path, flags, 0o644)
        except FileNotFoundError:
            self._folder.mkdir(parents=True, exist_ok=True)
            return os.open(path, flags, 0o644)
