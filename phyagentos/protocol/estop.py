"""The latch of the emergency stop: one file of a workspace. While it is there nothing moves, whoever starts again.

Upstream: the world process, which latches what it is asked for; the operator, who alone resets, with a reason.
Downstream: every target. Software requests a stop and logs it; it claims no performance level (ISO 13849-1).
"""

import os
from pathlib import Path

import msgspec

from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, Problem

LATCH = "estop.json"
_KEPT = "estop-reset-{stamp}.json"


class Latch(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What stands in the file.

    Attributes:
        by: Who asked for the stop.
        reason: Why.
        at: UTC wall time.
        reset_reason: Why it was reset; empty while it is latched.
        reset_at: UTC wall time of that.
    """

    by: str = ""
    reason: str = ""
    at: str = ""
    reset_reason: str = ""
    reset_at: str = ""


def is_latched(signals: Path) -> bool:
    """Whether the stop is latched in a folder `signals/`."""
    return (signals / LATCH).exists()


def read_latch(signals: Path) -> Latch | None:
    """The latch, or None; one that cannot be read is a latch all the same."""
    try:
        return msgspec.json.decode((signals / LATCH).read_bytes(), type=Latch)
    except FileNotFoundError:
        return None
    except msgspec.MsgspecError:
        return Latch(reason="the file of the latch cannot be read")


def latch(signals: Path, wanted: Latch) -> None:
    """Latch the stop; the first one stays. Targets see it at once, and it is durable when this returns.

    A disk may take a second to write; nothing that moves waits for it. A latch that a lost supply leaves empty holds
    all the same (see `read_latch`).

    Args:
        signals: The folder `signals/` of a workspace.
        wanted: By whom, why, when.
    """
    signals.mkdir(parents=True, exist_ok=True)
    temporary = signals / f".{LATCH}.{os.getpid()}.tmp"
    with temporary.open("wb") as file:
        file.write(_encode(wanted))
        file.flush()
        try:
            (signals / LATCH).hardlink_to(temporary)
        except FileExistsError:
            pass
        finally:
            temporary.unlink()
        os.fsync(file.fileno())
    _sync_folder(signals)


def reset(signals: Path, reason: str, clock: Clock) -> Path:
    """Let targets move again; the latch is kept beside with the reason.

    Args:
        signals: The folder `signals/` of a workspace.
        reason: Why it is safe again.
        clock: For the time of the reset.

    Returns:
        Where the former latch lies.

    Raises:
        DefinitionError: `REASON_MISSING`; `NOT_LATCHED`.
    """
    if not reason.strip():
        raise DefinitionError(
            Problem(code="REASON_MISSING", address="reset", found="no reason", expected="why it is safe to move again")
        )
    held = read_latch(signals)
    if held is None:
        raise DefinitionError(Problem(code="NOT_LATCHED", address=str(signals), found="no latched emergency stop"))
    at = clock.wall_iso()
    kept = signals / _KEPT.format(stamp=at.replace(":", "").replace(".", ""))
    temporary = signals / f".{LATCH}.{os.getpid()}.tmp"
    _write(temporary, msgspec.structs.replace(held, reset_reason=reason.strip(), reset_at=at))
    temporary.replace(signals / LATCH)
    (signals / LATCH).rename(kept)  # a rename wakes whoever waits; a removal would not
    _sync_folder(signals)
    return kept


def _encode(content: Latch) -> bytes:
    return msgspec.json.format(msgspec.json.encode(content)) + b"\n"


def _write(path: Path, content: Latch) -> None:
    with path.open("wb") as file:
        file.write(_encode(content))
        file.flush()
        os.fsync(file.fileno())


def _sync_folder(folder: Path) -> None:
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
