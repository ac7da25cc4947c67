"""Waiting for a change: woken by inotify, and by the poll under it."""

import errno
import select
import threading

import pytest

from phyagentos.store import watch as watch_module
from phyagentos.store.watch import Watch
from phyagentos.testing import ManualClock

SOON_S = 5.0  # far longer than a wake-up takes: a test that waits as long has failed


def create(folder):
    (folder / "new").touch()


def modify(folder):
    with (folder / "old").open("a") as file:
        file.write("more")


def move_in(folder):
    (folder.parent / "outside").rename(folder / "inside")


@pytest.fixture
def folder(tmp_path):
    folder = tmp_path / "watched"
    folder.mkdir()
    (folder / "old").touch()
    (tmp_path / "outside").touch()
    return folder


@pytest.mark.parametrize("change", [create, modify, move_in])
@pytest.mark.parametrize("use_inotify", [True, False])
def test_every_change_wakes(folder, tmp_path, change, use_inotify):
    with Watch([tmp_path, folder], poll_s=0.01, use_inotify=use_inotify) as watch:
        assert watch.is_event_driven is use_inotify
        assert watch.wait(0.0) is False
        change(folder)
        assert watch.wait(SOON_S) is True


def test_a_change_while_waiting_wakes_at_once(folder):
    with Watch([folder], poll_s=1000) as watch:
        threading.Timer(0.05, create, [folder]).start()
        assert watch.wait(SOON_S) is True


def test_nothing_new_is_no_change(folder):
    with Watch([folder]) as watch:
        create(folder)
        assert watch.wait(SOON_S) is True
        (folder / "old").read_text()
        assert watch.wait(0.0) is False


def test_the_poll_sees_what_inotify_does_not_tell(folder, monkeypatch):
    with Watch([folder], poll_s=0.01) as watch:
        monkeypatch.setattr(watch._inotify, "read", lambda **_: [])
        modify(folder)
        assert watch.wait(SOON_S) is True


@pytest.mark.slow
def test_an_overflow_of_the_queue_wakes(folder):
    with Watch([folder], poll_s=1000) as watch:
        for number in range(8_500):  # of two events each; the kernel keeps 16384
            (folder / "old").rename(folder / f"old{number}")
            (folder / f"old{number}").rename(folder / "old")
        assert watch.wait(SOON_S) is True
        while watch.drain():
            pass
        create(folder)
        assert watch.wait(SOON_S) is True


def test_it_waits_together_with_other_objects(folder):
    with Watch([folder]) as watch:
        assert select.select([watch], [], [], 0)[0] == []
        create(folder)
        assert select.select([watch], [], [], SOON_S)[0] == [watch]
        assert watch.drain() is True
        assert watch.drain() is False
        assert select.select([watch], [], [], 0)[0] == []


def test_without_inotify_it_polls_and_says_so(folder, monkeypatch):
    def refuse(**_):
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(watch_module.inotify_simple, "INotify", refuse)
    clock = ManualClock()
    with Watch([folder], clock=clock) as watch:
        assert not watch.is_event_driven
        assert select.select([watch], [], [], 0)[0] == []
        assert watch.drain() is False
        assert watch.wait(2.5) is False
        assert clock.now_s() == 2.5
        create(folder)
        assert watch.wait(2.5) is True
        assert clock.now_s() == 3.5


def test_a_folder_that_goes_away_is_survived(folder):
    with Watch([folder], poll_s=0.01) as watch:
        for path in folder.iterdir():
            path.unlink()
        folder.rmdir()
        watch.wait(0.05)
        assert watch.wait(0.05) in (True, False)
