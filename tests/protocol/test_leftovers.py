"""Leftovers of killed processes are swept; what lives, and what is not ours, stays."""

import os
import socket
import subprocess
import sys
import tempfile

import pytest

from phyagentos.protocol.documents.leftovers import LISTENING_S, WRITTEN_S, sweep_leftovers


@pytest.fixture
def scratch(tmp_path, monkeypatch):
    folder = tmp_path / "tmp"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def test_half_written_files_go_once_their_process_is_gone_or_they_are_old(tmp_path, scratch):
    pid = subprocess.check_output([sys.executable, "-c", "import os; print(os.getpid())"], text=True).strip()
    root = tmp_path / "w"
    (root / "proposals" / "new").mkdir(parents=True)
    (root / "evidence").mkdir()
    now_s = root.stat().st_mtime
    of_killed, old = root / f".TASK.md.{pid}.tmp", root / "proposals" / "new" / ".0a1b2c3d.tmp"
    stays = [root / f".TASK.md.{os.getpid()}.tmp", root / "evidence" / ".x.tmp", root / "TASK.tmp"]
    for path in (of_killed, old, *stays):
        path.write_text("half")
    (root / ".skills.tmp").mkdir()
    sweep_leftovers(root, now_s)
    assert (of_killed.exists(), old.exists(), all(map(os.path.exists, stays))) == (False, True, True)
    sweep_leftovers(root, now_s + WRITTEN_S + 60.0)
    assert not old.exists()
    assert not (root / ".skills.tmp").exists()
    assert all(map(os.path.exists, stays[1:]))


@pytest.mark.parametrize("kind", [socket.SOCK_STREAM, socket.SOCK_SEQPACKET])
def test_a_folder_of_sockets_goes_once_no_process_listens(tmp_path, scratch, kind):
    (tmp_path / "w").mkdir()
    folder = scratch / "paos-fork-x"
    folder.mkdir()
    later_s = folder.stat().st_mtime + LISTENING_S + 60.0
    with socket.socket(socket.AF_UNIX, kind) as listener:
        listener.bind(str(folder / "socket"))
        listener.listen()
        sweep_leftovers(tmp_path / "w", later_s)
        assert folder.exists()
    sweep_leftovers(tmp_path / "w", folder.stat().st_mtime)
    assert folder.exists(), "it may be about to listen"
    sweep_leftovers(tmp_path / "w", later_s)
    assert not folder.exists()
