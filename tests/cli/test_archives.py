"""A workspace in one file, and back: the same bytes, or a clear refusal and no folder."""

import fcntl
import io
import json
import tarfile
from pathlib import Path

import pytest

from phyagentos.cli.outcome import ExitCode
from phyagentos.protocol.workspace.process_lock import WATCHDOG_LOCK
from tests.stored_workspace import unpack_stored


@pytest.fixture
def root(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return unpack_stored(tmp_path)


def read(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def count_links(folder):
    return sum(path.stat().st_nlink > 1 for path in folder.rglob("*") if path.is_file())


def test_what_is_restored_is_what_was_packed(paos, root):
    packed = json.loads(paos("archive", root, "demo.tar.gz", "--json").out)
    restored = json.loads(paos("restore", "demo.tar.gz", "back", "--json").out)
    assert read(root) == read(Path("back"))
    assert count_links(Path("back")) == count_links(root) > 0, "what is stored once takes its space twice"
    assert packed["files"] == restored["files"] == len(read(root))
    assert Path("demo.tar.gz").stat().st_mode & 0o777 == 0o600
    assert paos("why", "red", "-w", "back").code == ExitCode.GOAL_MET


def test_what_stands_there_is_not_written_over(paos, root):
    paos("archive", root, "demo.tar.gz")
    for command in (("archive", root, "demo.tar.gz"), ("restore", "demo.tar.gz", root)):
        before = (Path("demo.tar.gz").read_bytes(), read(root))
        done = paos(*command)
        assert (done.code, "WOULD_OVERWRITE" in done.err) == (ExitCode.INVALID_INPUT, True)
        assert before == (Path("demo.tar.gz").read_bytes(), read(root))


def test_a_workspace_that_is_served_is_not_packed(paos, root):
    (root / WATCHDOG_LOCK).parent.mkdir(exist_ok=True)
    with (root / WATCHDOG_LOCK).open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = paos("archive", root, "demo.tar.gz")
    assert "BUSY" in done.err
    assert not Path("demo.tar.gz").exists()


def cut(data):
    return data[: len(data) // 2]


def flip(data):
    return data[:-4000] + bytes([data[-4000] ^ 0xFF]) + data[-3999:]


@pytest.mark.parametrize("damage", [cut, flip, lambda data: b"", lambda data: b"text"])
def test_a_damaged_archive_is_refused_and_leaves_no_folder(paos, root, damage):
    paos("archive", root, "demo.tar.gz")
    Path("demo.tar.gz").write_bytes(damage(Path("demo.tar.gz").read_bytes()))
    before = sorted(Path().iterdir())
    done = paos("restore", "demo.tar.gz", "back")
    assert (done.code, "UNREADABLE_FILE" in done.err) == (ExitCode.INVALID_INPUT, True), done.err
    assert sorted(Path().iterdir()) == before


def repack(change=lambda member, data: data, more=()):
    with tarfile.open("demo.tar.gz") as old, tarfile.open("other.tar.gz", "w:gz") as new:
        for member in old:
            data = change(member, old.extractfile(member).read()) if member.isfile() else b""
            new.addfile(member, io.BytesIO(data))
        for name in more:
            new.addfile(tarfile.TarInfo(name))


def test_other_bytes_than_the_index_lists_are_refused(paos, root):
    paos("archive", root, "demo.tar.gz")
    repack(lambda member, data: data.replace(b"success", b"SUCCESS") if member.name.endswith("TASK.md") else data)
    assert "TASK.md is missing, or is not what was packed" in paos("restore", "other.tar.gz", "back").err
    assert not Path("back").exists()


@pytest.mark.parametrize("name", ["workspace/unlisted", "../outside", "/tmp/outside"])
def test_what_the_index_does_not_list_is_not_unpacked(paos, root, name):
    paos("archive", root, "demo.tar.gz")
    repack(more=[name])
    done = paos("restore", "other.tar.gz", "back")
    assert (done.code, f"{name} is not in archive.json" in done.err) == (ExitCode.INVALID_INPUT, True)
    assert not Path("back").exists()
    assert not Path("../outside").exists()
