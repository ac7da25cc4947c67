"""A full disk is named, whatever raised the error and whoever called; each problem of a file is raised once."""

import errno
import shutil
import signal
from pathlib import Path

import pytest

from phyagentos import errors
from phyagentos.errors import DefinitionError, Problem, find_full_disk, list_foreign_errors, raise_any

FULL = OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize(
    ("error", "found"),
    [
        (OSError(errno.ENOSPC, "No space left on device", "/full/a"), "/full/a"),
        (OSError(errno.ENOSPC, "No space left on device", "/else/a", None, "/full/b"), "/full/b"),
        (shutil.Error([("/else/a", "/full/c", str(FULL))]), "/full/c"),
        (PermissionError(errno.EACCES, "Permission denied", "/full/a"), ""),
        (ValueError("No space left on device"), ""),
    ],
)
def test_the_place_of_a_write_without_room_is_that_of_the_error(error, found):
    assert find_full_disk(error) == found


def test_where_the_system_names_none_it_is_the_path_on_the_full_disk_that_the_calls_knew(monkeypatch):
    monkeypatch.setattr(errors, "has_room", lambda path: not path.is_relative_to("/full"))

    def write(read, written):
        raise FULL

    with pytest.raises(OSError, match="No space left") as raised:
        write(Path("/else"), Path("/full/journal"))
    assert find_full_disk(raised.value) == "/full/journal"


@pytest.mark.parametrize(("heard", "is_foreign"), [(signal.default_int_handler, False), (signal.SIG_IGN, True)])
def test_an_interrupt_is_an_error_of_a_persons_code_where_no_keyboard_reaches(heard, is_foreign):
    before = signal.signal(signal.SIGINT, heard)
    try:
        assert (KeyboardInterrupt in list_foreign_errors()) is is_foreign
    finally:
        signal.signal(signal.SIGINT, before)


def test_problems_are_raised_together_each_once_and_none_raises_nothing():
    raise_any(iter(()))
    one, other = Problem("SYNTAX", "a.yaml:1:1"), Problem("SYNTAX", "a.yaml:2:1")
    with pytest.raises(DefinitionError) as raised:
        raise_any(iter((one, other, one)))
    assert raised.value.problems == (one, other)
