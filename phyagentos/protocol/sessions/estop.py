"""The latch of the emergency stop: one file of a workspace. While it exists, no target moves, restarts included.

Only the operator resets it, with a reason. It claims no performance level (ISO 13849-1).
"""

import contextlib
import os
from pathlib import Path

import msgspec

from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.durable_files import replace_durably, sync_folder
from phyagentos.protocol.documents.plain_text import clean
from phyagentos.protocol.documents.regular_files import REQUEST_MAX, UnfitFileError, read_regular

LATCH = "estop.json"
RESERVE = ".estop.reserve"
_KEPT = "estop-reset-{stamp}.json"


class Latch(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The content of the file; `reset_reason` and `reset_at` are empty while the stop is latched."""

    by: str = ""
    reason: str = ""
    at: str = ""
    reset_reason: str = ""
    reset_at: str = ""


def is_latched(signals: Path) -> bool:
    """Whether the stop is latched in the folder `signals/` of a workspace."""
    try:
        os.lstat(f"{signals}/{LATCH}")  # before every command; a link to nowhere keeps the latch out of its place
    except (FileNotFoundError, NotADirectoryError):
        return False
    return True


def read_latch(signals: Path) -> Latch | None:
    """The latch, or None; an unreadable one is a latch all the same."""
    try:
        return msgspec.json.decode(read_regular(signals / LATCH, REQUEST_MAX, follow=False), type=Latch)
    except FileNotFoundError:
        return None
    except (ValueError, RecursionError, UnfitFileError):
        return Latch(reason="the file of the latch cannot be read")


def latch(signals: Path, wanted: Latch) -> None:
    """Latch the stop; the first one stays. Targets see it at once, and it is durable when this returns.

    Motion does not wait for a slow disk. An empty latch, left by a power failure, holds too (see `read_latch`). On a
    full disk the reserve becomes the latch: renaming needs no space.

    Raises:
        OSError: The disk did not take it, or did not confirm; `is_latched` shows whether it is latched.
    """
    try:
        signals.mkdir(parents=True, exist_ok=True)
        _link(signals, wanted)
    except OSError:
        if is_latched(signals):
            raise
        (signals / RESERVE).rename(signals / LATCH)
    sync_folder(signals)


def provide_reserve(signals: Path) -> None:
    """Prepare the file that becomes the latch when the disk is full."""
    signals.mkdir(parents=True, exist_ok=True)
    if not (signals / RESERVE).exists():
        content = Latch(reason="the disk was full: who asked and why could not be written")
        with contextlib.suppress(OSError):
            replace_durably(signals / RESERVE, _encode(content))


def _link(signals: Path, wanted: Latch) -> None:
    temporary = signals / f".{LATCH}.{os.getpid()}.tmp"
    try:
        with temporary.open("wb") as file:
            file.write(_encode(wanted))
            file.flush()
            with contextlib.suppress(FileExistsError):
                (signals / LATCH).hardlink_to(temporary)
            os.fsync(file.fileno())
    finally:
        temporary.unlink(missing_ok=True)


def reset(signals: Path, reason: str, clock: Clock) -> Path:
    """Let targets move again; the former latch is kept beside, with the reason it is safe; its path is returned.

    Raises:
        DefinitionError: `MISSING_VALUE`; `ALREADY_OVER`.
    """
    if not reason.strip():
        raise DefinitionError.of("MISSING_VALUE", "reset", "no reason", "why it is safe to move again")
    held = read_latch(signals)
    if held is None:
        raise DefinitionError.of("ALREADY_OVER", str(signals), "no latched emergency stop")
    at = clock.wall_iso()
    kept = signals / _KEPT.format(stamp=at.replace(":", "").replace(".", ""))
    replace_durably(signals / LATCH, _encode(msgspec.structs.replace(held, reset_reason=reason.strip(), reset_at=at)))
    (signals / LATCH).rename(kept)  # a rename wakes the watchers; a removal would not
    sync_folder(signals)
    provide_reserve(signals)
    return kept


def _encode(content: Latch) -> bytes:
    fields = {name: clean(text) for name, text in msgspec.structs.asdict(content).items()}  # JSON takes not every text
    return msgspec.json.format(msgspec.json.encode(Latch(**fields))) + b"\n"
