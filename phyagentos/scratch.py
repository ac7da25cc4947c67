"""A temporary folder that no signal leaves behind."""

import contextlib
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def open_scratch(purpose: str = "paos") -> Iterator[Path]:
    """A new folder of this user alone, below the one for temporary files, removed at the end of the block.

    A signal that raises (Ctrl-C, SIGTERM of a command) may come at any point: its name is chosen before it is made, so
    it is removed even by one that comes between its making and the block, which leaves `tempfile.TemporaryDirectory`.
    """
    folder = Path(tempfile.gettempdir(), f"{purpose}-{secrets.token_hex(5)}")
    try:
        folder.mkdir(mode=0o700)
        yield folder
    finally:
        if folder.exists():
            shutil.rmtree(folder)
