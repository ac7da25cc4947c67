"""What the children of a watchdog leave behind when they cannot start."""

import io
import os
import weakref

import pytest

from phyagentos.assembly import processes, worker_process
from phyagentos.errors import DefinitionError


def test_a_child_has_told_why_before_its_connections_close(monkeypatch):
    told, at_the_end = io.StringIO(), []

    def break_off(*given, **named):
        connection = io.BytesIO()
        weakref.finalize(connection, lambda: at_the_end.append(told.getvalue()))  # the supervisor kills at this moment
        raise DefinitionError.of("MODEL_INVALID", "arm.xml", "a torn file", "a model")

    monkeypatch.setattr(worker_process, "run_worker", break_off)
    monkeypatch.setattr("sys.stderr", told)
    with pytest.raises(SystemExit) as end:
        processes.main(["worker", "--workspace", "w", "--target", "arm"])
    assert end.value.code == os.EX_SOFTWARE
    del end
    assert "MODEL_INVALID" in at_the_end[0]
