"""Files that others put there: only small regular ones are read, and none is waited for."""

import os

import pytest

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.registries import get_registered_target, publish_health
from phyagentos.protocol.capabilities.targets import Health, TargetHealth
from phyagentos.protocol.documents.regular_files import DOCUMENT_MAX, UnfitFileError, read_regular
from phyagentos.protocol.sessions.heartbeats import read_heartbeats


def lay_sparse(path):
    with path.open("wb") as file:
        file.truncate(10**9)


UNFIT = {
    "FIFO": os.mkfifo,
    "loop": lambda path: path.symlink_to(path.name),
    "device": lambda path: path.symlink_to("/dev/zero"),
    "huge": lay_sparse,
}


@pytest.fixture(params=UNFIT)
def unfit(tmp_path, request):
    path = tmp_path / "panda.json"
    UNFIT[request.param](path)
    return path


def test_a_document_that_is_no_small_regular_file_is_unreadable(unfit):
    with pytest.raises(DefinitionError, match=r"panda\.json: UNREADABLE_FILE: found .*Is this a workspace\?"):
        get_registered_target(unfit, "panda")
    assert not publish_health(unfit, {"panda": TargetHealth(state=Health.LOST)})


def test_a_heartbeat_that_is_none_holds_up_nobody(unfit):
    assert read_heartbeats(unfit.parent) == {}


@pytest.mark.parametrize("size", [0, 1, 65_536, 100_000])
def test_a_file_is_read_up_to_its_bound(tmp_path, size):
    (tmp_path / "f").write_bytes(data := os.urandom(size))
    (tmp_path / "link").symlink_to("f")

    assert read_regular(tmp_path / "f", size) == read_regular(tmp_path / "link", DOCUMENT_MAX) == data
    with pytest.raises(UnfitFileError, match="symbolic link"):
        read_regular(tmp_path / "link", follow=False)
    (tmp_path / "f").write_bytes(data + b"x")
    with pytest.raises(UnfitFileError, match=f"more than {size} bytes"):
        read_regular(tmp_path / "f", size)


def test_a_file_of_a_file_system_that_tells_no_sizes_is_read_and_bounded():
    assert b"Name:" in read_regular("/proc/self/status")
    with pytest.raises(UnfitFileError, match="more than 100 bytes"):
        read_regular("/proc/self/status", 100)
