"""Folders of sockets lie in TMPDIR; none outlives the runtime that made it, or the next one."""

import os
import tempfile

from phyagentos.assembly.paths import make_socket_folder, remove_socket_folders
from phyagentos.clock import SystemClock
from phyagentos.protocol.workspace.process_lock import WATCHDOG_LOCK, become_sole


def test_the_folders_of_ended_and_killed_runtimes_go_and_that_of_a_living_one_stays(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    ended, killed, gone, alive = (make_socket_folder(tmp_path / name) for name in ("ended", "killed", "gone", "alive"))
    (killed / "arm.world").touch()
    locks = [
        become_sole(tmp_path / name / WATCHDOG_LOCK, SystemClock(), "BUSY", "there is one")
        for name in ("ended", "alive")
    ]

    remove_socket_folders(tmp_path / "ended")

    for lock in locks:
        os.close(lock)
    assert [each.exists() for each in (ended, killed, gone, alive)] == [False, False, False, True]
