"""Files that a power cut does not take back."""

import os
from collections.abc import Callable
from pathlib import Path

from phyagentos.errors import DefinitionError


def replace_durably(path: Path, data: bytes) -> None:
    """Replace a file as a whole; content and name are on the disk when this returns. Raises OSError."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def create_durably(path: Path, data: bytes) -> bool:
    """Create a file as a whole; whether there was none of this name, in a folder that is made. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{os.urandom(4).hex()}.tmp")
    temporary.write_bytes(data)
    try:
        path.hardlink_to(temporary)
    except FileExistsError:
        return False
    finally:
        temporary.unlink()
    sync_folder(path.parent)
    return True


def require_empty(folder: Path, hint: str = "Choose another name.") -> None:
    """Raise DefinitionError `WOULD_OVERWRITE` unless a folder is missing or empty."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        found = "a file" if folder.is_file() else "a folder that is not empty"
        raise DefinitionError.of("WOULD_OVERWRITE", str(folder), found, "a folder that is missing or empty", hint)


def sync_folder(folder: Path, sync: Callable[[int], None] | None = None) -> None:
    """Make the names in a folder durable, by `os.fsync` or `sync`; raises OSError, or what `sync` raises."""
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        (sync or os.fsync)(fd)
    finally:
        os.close(fd)
