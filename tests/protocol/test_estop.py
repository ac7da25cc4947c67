"""The latch of the emergency stop: durable, first one stays, reset only with a reason."""

import errno
import json
import os
from pathlib import Path

import pytest

from phyagentos.errors import DefinitionError
from phyagentos.protocol.sessions.estop import (
    LATCH,
    RESERVE,
    Latch,
    is_latched,
    latch,
    provide_reserve,
    read_latch,
    reset,
)
from phyagentos.testing import ManualClock


def test_the_first_latch_stays(tmp_path):
    latch(tmp_path, Latch(by="anna", reason="smoke"))
    latch(tmp_path, Latch(by="ben", reason="noise"))

    assert is_latched(tmp_path)
    assert read_latch(tmp_path).by == "anna"
    assert [path.name for path in tmp_path.iterdir()] == [LATCH]


def test_targets_see_the_latch_before_anything_waits_for_the_disk(tmp_path, monkeypatch):
    seen, sync = [], os.fsync
    monkeypatch.setattr(os, "fsync", lambda fd: (seen.append(read_latch(tmp_path)), sync(fd)))
    latch(tmp_path, Latch(by="anna", reason="smoke"))

    assert [each and each.by for each in seen] == ["anna", "anna"]  # the file, then its folder


def test_a_reset_keeps_who_stopped_and_why_it_is_safe_again(tmp_path):
    latch(tmp_path, Latch(by="anna", reason="smoke"))
    kept = reset(tmp_path, "it was steam", ManualClock())

    assert not is_latched(tmp_path)
    assert json.loads(kept.read_text()) | {"at": ""} == {
        "by": "anna",
        "reason": "smoke",
        "reset_reason": "it was steam",
        "reset_at": "1970-01-01T00:00:00.000000Z",
        "at": "",
    }


def test_a_reset_needs_a_reason_and_something_to_reset(tmp_path):
    with pytest.raises(DefinitionError, match="ALREADY_OVER"):
        reset(tmp_path, "why not", ManualClock())
    latch(tmp_path, Latch(by="anna"))
    with pytest.raises(DefinitionError, match="MISSING_VALUE"):
        reset(tmp_path, "  ", ManualClock())
    assert is_latched(tmp_path)


@pytest.mark.parametrize(
    "data", [b"garbage", b'{"by": "\xff"}', b'{"by":' + b"[" * 5000], ids=["words", "bytes", "deep"]
)
def test_a_latch_that_cannot_be_read_still_stops(tmp_path, data):
    (tmp_path / LATCH).write_bytes(data)

    assert is_latched(tmp_path)
    assert "cannot be read" in read_latch(tmp_path).reason


def refuse_to_write(monkeypatch):
    """A full disk: no new file, no byte more; what is there can be renamed."""

    def refuse(path, *_, **__):
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr(Path, "open", refuse)


def test_on_a_full_disk_the_reserve_becomes_the_latch(tmp_path, monkeypatch):
    provide_reserve(tmp_path)
    with monkeypatch.context() as full:
        refuse_to_write(full)
        latch(tmp_path, Latch(by="anna", reason="smoke"))

    assert is_latched(tmp_path)
    assert "the disk was full" in read_latch(tmp_path).reason
    reset(tmp_path, "all is well", ManualClock())
    assert not is_latched(tmp_path)
    assert (tmp_path / RESERVE).exists()


def test_a_full_disk_takes_no_second_latch_and_keeps_the_first(tmp_path, monkeypatch):
    provide_reserve(tmp_path)
    latch(tmp_path, Latch(by="anna", reason="smoke"))
    with monkeypatch.context() as full:
        refuse_to_write(full)
        with pytest.raises(OSError, match="No space"):
            latch(tmp_path, Latch(by="ben"))

    assert read_latch(tmp_path).by == "anna"


def test_a_full_disk_without_a_reserve_says_so_and_no_reserve_is_left_half(tmp_path, monkeypatch):
    with monkeypatch.context() as full:
        refuse_to_write(full)
        provide_reserve(tmp_path)
        with pytest.raises(OSError):  # noqa: PT011 - whichever of the two
            latch(tmp_path, Latch(by="anna"))

    assert not list(tmp_path.iterdir())
