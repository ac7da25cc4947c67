"""Sockets are in their workspace: no other runtime and no cleaner of TMPDIR ends a run, and paths may be long."""

import shutil
import socket
import threading

import pytest

from phyagentos.assembly.paths import make_socket_folder, remove_socket_folders
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.channel import connect
from phyagentos.runtime.targets import agreement, server
from phyagentos.runtime.targets.agreement import AgreementReceiver, AgreementSender
from phyagentos.runtime.targets.server import UnixDoor


def test_the_end_of_a_runtime_removes_its_own_sockets_alone_and_a_copied_folder_becomes_private_again(tmp_path):
    ended, other = (make_socket_folder(tmp_path / name) for name in ("ended", "other"))
    other.chmod(0o755)

    remove_socket_folders(tmp_path / "ended")

    assert not ended.exists()
    assert make_socket_folder(tmp_path / "other").stat().st_mode & 0o077 == 0
    other.rmdir()
    other.symlink_to(tmp_path)
    with pytest.raises(ExecutionError, match="NOT_SECURED"):
        make_socket_folder(tmp_path / "other")


def test_a_workspace_is_opened_beside_the_sockets_of_its_runtime_and_with_no_other(tmp_path):
    root = Workspace.create(tmp_path / "w", Library(())).root
    for folder in (make_socket_folder(root), root / ".world"):
        Workspace.open(root)
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(str(folder / "arm.world"))
    with pytest.raises(DefinitionError, match="LEADS_OUT: found a socket"):
        Workspace.open(root)


def test_a_world_whose_socket_is_taken_away_listens_again_at_a_path_of_any_length(tmp_path, monkeypatch):
    monkeypatch.setattr(server, "LOOK_S", 0.02)
    monkeypatch.setattr(agreement, "LOOK_S", 0.02)
    place = make_socket_folder(tmp_path / ("long" * 30)) / "arm.world"
    receiver, sender = AgreementReceiver(place.with_name("table.time")), AgreementSender(place.with_name("table.time"))
    assert sender.send({"arm": "s-1"})
    assert receiver.read() == {"arm": "s-1"}
    threading.Thread(target=receiver.wake, args=(threading.Condition(),), daemon=True).start()
    door = UnixDoor(str(place))
    shutil.rmtree(place.parent)
    accepted = []
    thread = threading.Thread(target=lambda: accepted.append(door.accept()))
    thread.start()
    while not place.exists():
        thread.join(0.01)
    client = connect(place)
    thread.join()
    client.send_bytes(b"here")
    assert accepted[0].recv_bytes() == b"here"
    while not sender.send({"arm": "s-2"}):
        thread.join(0.01)
    while receiver.read() != {"arm": "s-2"}:
        thread.join(0.01)
    for each in (client, *accepted, door, receiver, sender):
        each.close()
