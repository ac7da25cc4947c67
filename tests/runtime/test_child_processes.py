"""What the children of a watchdog leave behind when they cannot start."""

import io
import os
import sys
import weakref

import pytest

from phyagentos.assembly import worker_process
from phyagentos.errors import DefinitionError, ExecutionError


def test_a_child_has_told_why_before_its_connections_close(monkeypatch):
    told, at_the_end = io.StringIO(), []

    def break_off(*given, **named):
        connection = io.BytesIO()
        weakref.finalize(connection, lambda: at_the_end.append(told.getvalue()))  # the supervisor kills at this moment
        raise DefinitionError.of("MODEL_INVALID", "arm.xml", "a torn file", "a model")

    monkeypatch.setattr(worker_process, "run_worker", break_off)
    monkeypatch.setattr("sys.stderr", told)
    with pytest.raises(SystemExit) as end:
        worker_process.main(["--workspace", "w", "--target", "arm", "--socket", "s", "--control", "3"])
    assert end.value.code == os.EX_SOFTWARE
    del end
    assert "MODEL_INVALID" in at_the_end[0]


@pytest.mark.parametrize("error", [ExecutionError("TARGET_LOST", "it is gone"), OSError(28, "No space left on device")])
def test_a_child_whose_log_is_on_a_full_disk_ends_with_its_own_code_all_the_same(monkeypatch, error):
    """Else the watchdog takes it for one that Python of a person has ended, and no other attempt is made."""

    def break_off(*given, **named):
        raise error

    class Full(io.StringIO):
        def flush(self):
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(worker_process, "run_worker", break_off)
    monkeypatch.setattr("sys.stderr", Full())
    with pytest.raises(SystemExit) as end:
        worker_process.main(["--workspace", "w", "--target", "arm", "--socket", "s", "--control", "3"])
    assert end.value.code == os.EX_SOFTWARE
    assert sys.stderr is None
