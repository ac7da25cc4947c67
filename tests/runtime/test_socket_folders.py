"""Sockets are in their workspace: no other runtime and no cleaner of TMPDIR ends a run, and paths may be long."""

import shutil
import threading

import pytest

from phyagentos.assembly.paths import make_socket_folder, remove_socket_folders
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.channel import connect
from phyagentos.runtime.targets import server
from phyagentos.runtime.targets.agreement import AgreementReceiver, AgreementSender
from phyagentos.runtime.targets.server import UnixDoor


def test_the_end_of_a_runtime_removes_its_own_sockets_alone(tmp_path):
    ended, other = (make_socket_folder(tmp_path / name) for name in ("ended", "other"))
    (ended / "arm.world").touch()

    remove_socket_folders(tmp_path / "ended")
    remove_socket_folders(tmp_path / "nowhere")

    assert [each.exists() for each in (ended, other)] == [False, True]


def test_a_copied_folder_becomes_private_again_and_one_that_leads_elsewhere_is_refused(tmp_path):
    folder = make_socket_folder(tmp_path / "w")
    folder.chmod(0o755)
    assert make_socket_folder(tmp_path / "w").stat().st_mode & 0o077 == 0
    folder.rmdir()
    folder.symlink_to(tmp_path)
    with pytest.raises(ExecutionError, match="SOCKETS_UNSAFE"):
        make_socket_folder(tmp_path / "w")


def test_a_workspace_is_opened_beside_the_sockets_of_its_runtime_and_with_no_other(tmp_path):
    root = Workspace.create(tmp_path / "w", Library(())).root
    door = UnixDoor(str(make_socket_folder(root) / "arm.world"))
    assert Workspace.open(root).root == root
    other = UnixDoor(str(root / ".world" / "arm.world"))
    with pytest.raises(DefinitionError, match="LEADS_OUT: found a socket"):
        Workspace.open(root)
    for each in (door, other):
        each.close()


def test_a_world_whose_socket_is_taken_away_listens_again_at_a_path_of_any_length(tmp_path, monkeypatch):
    monkeypatch.setattr(server, "LOOK_S", 0.02)
    place = make_socket_folder(tmp_path / ("long" * 30)) / "arm.world"
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
    for each in (client, *accepted, door):
        each.close()


def test_what_runs_reaches_a_shared_world_at_a_path_of_any_length(tmp_path):
    place = make_socket_folder(tmp_path / ("long" * 30)) / "table.time"
    sender = AgreementSender(place)
    assert not sender.send({})
    receiver = AgreementReceiver(place)
    assert sender.send({"arm": "s-1"})
    assert receiver.read() == {"arm": "s-1"}
    sender.close()
    receiver.close()
