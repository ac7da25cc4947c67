"""Stop requests as files: each arrives once, and what cannot be read is kept with the reason."""

import errno
import os
import re
import threading
from pathlib import Path

import pytest

from phyagentos.protocol.sessions import stop_signals as mailbox
from phyagentos.protocol.sessions.stop_signals import DONE_KEPT, Signal, SignalReader, drop_signal, take_signals
from phyagentos.testing import ManualClock
from tests.protocol.test_regular_files import lay_sparse


def make_old(path):
    os.utime(path, (1, 1))


def test_a_signal_arrives_once_and_is_kept(tmp_path, clock):
    path = drop_signal(tmp_path, Signal(kind="cancel", session="g.red", by="ann", reason="supper"), clock)

    assert take_signals(tmp_path) == [
        Signal(kind="cancel", session="g.red", by="ann", reason="supper", at=clock.wall_iso())
    ]
    assert take_signals(tmp_path) == []
    assert not path.exists()
    assert (tmp_path / "done" / path.name).exists()


@pytest.mark.parametrize("text", ["kind: cancel\nsession: g.red\n", '{"kind": "cancel", "session": "g.red"}'])
def test_any_tool_can_drop_one(tmp_path, text):
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "by-hand").write_text(text)

    assert take_signals(tmp_path) == [Signal(kind="cancel", session="g.red")]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("kind: cancle\n", r"Invalid enum value 'cancle'.*Did you mean 'cancel'"),
        ("kind: [", "only one mapping, of words to words.*line 1, column 7"),
        ("", "Expected `object`"),
        ("kind: cancel\nsesion: x\n", "unknown field `sesion`"),
        ("\x00\x01", "Expected `object`"),
    ],
)
def test_what_cannot_be_read_is_put_aside_with_the_reason(tmp_path, text, reason):
    (tmp_path / "new").mkdir()
    path = tmp_path / "new" / "by-hand.yaml"
    path.write_text(text)
    assert take_signals(tmp_path) == []
    assert path.exists(), "somebody may still be writing it"

    make_old(path)
    assert take_signals(tmp_path) == []

    assert (tmp_path / "rejected" / "by-hand.yaml").read_text() == text
    told = (tmp_path / "rejected" / "by-hand.yaml.reason.txt").read_text()
    assert re.search(f"by-hand.yaml: .*{reason}", told, re.DOTALL)
    assert "cancel, pause, resume, take_over, estop" in told
    assert list((tmp_path / "new").iterdir()) == []


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (os.mkfifo, "no regular file"),
        (lambda path: path.symlink_to(path.name), "symbolic link"),
        (lambda path: path.symlink_to("/proc/kmsg"), "symbolic link"),
        (lambda path: path.symlink_to(path.parent.parent / "valid"), "symbolic link"),
        (lay_sparse, "more than 65536 bytes"),
    ],
)
def test_what_is_no_small_regular_file_is_moved_aside_unread_and_a_stop_beside_it_is_heard(tmp_path, make, reason):
    (tmp_path / "new").mkdir()
    (tmp_path / "valid").write_text("kind: resume")
    make(tmp_path / "new" / "a")
    (tmp_path / "new" / "b").write_text("kind: estop")

    assert SignalReader(tmp_path).read_new() == take_signals(tmp_path) == [Signal(kind="estop")]
    assert list((tmp_path / "new").iterdir()) == []
    assert os.path.lexists(tmp_path / "rejected" / "a")
    assert reason in (tmp_path / "rejected" / "a.reason.txt").read_text()


def test_the_taker_goes_on_with_its_other_work_between_two_hundred_requests_and_the_next(tmp_path):
    lay(tmp_path / "new", 450, 1_000)
    turns = [mailbox.take_some(tmp_path) for _ in range(3)]

    assert [(len(taken), goes_on) for taken, goes_on in turns] == [(200, True), (200, True), (50, False)]


def test_every_reader_gets_every_signal_once_whoever_is_faster(tmp_path, clock):
    early, late = SignalReader(tmp_path), SignalReader(tmp_path / "new")
    taken, heard = [], []
    for number in range(20):
        drop_signal(tmp_path, Signal(kind="cancel", reason=str(number)), clock)
        if number % 3 == 0:
            taken += take_signals(tmp_path)
        if number % 2 == 0:
            heard += early.read_new()
        clock.advance(1)
    taken += take_signals(tmp_path)
    expected = [str(number) for number in range(20)]

    assert [signal.reason for signal in taken] == expected
    assert [signal.reason for signal in late.read_new()] == expected
    assert [signal.reason for signal in [*heard, *early.read_new()]] == expected
    assert late.read_new() == early.read_new() == []


def test_a_reader_waits_for_a_file_that_is_finished_late_and_survives_one_of_the_same_name(tmp_path):
    reader = SignalReader(tmp_path)
    (tmp_path / "new").mkdir()
    path = tmp_path / "new" / "stop"
    path.touch()
    assert reader.read_new() == []
    for kind in ("pause", "resume"):
        path.write_text(f"kind: {kind}\n")
        assert [signal.kind for signal in reader.read_new()] == [kind]
        take_signals(tmp_path)
        assert reader.read_new() == []

    assert {each.name for each in (tmp_path / "done").iterdir()} == {"stop", "stop.1"}


def test_readers_and_the_taker_at_the_same_time_lose_nothing(tmp_path):
    clock, readers, heard = ManualClock(), [SignalReader(tmp_path) for _ in range(2)], [[], [], []]
    is_over = threading.Event()

    def listen(read, heard):
        while not is_over.wait(0.002):
            heard.extend(read())
        heard.extend(read())

    reads = [reader.read_new for reader in readers] + [lambda: take_signals(tmp_path)]
    threads = [threading.Thread(target=listen, args=each) for each in zip(reads, heard, strict=True)]
    for thread in threads:
        thread.start()
    for number in range(50):
        drop_signal(tmp_path, Signal(kind="cancel", reason=str(number)), clock)
    is_over.set()
    for thread in threads:
        thread.join()

    for each in heard:
        assert sorted(int(signal.reason) for signal in each) == list(range(50))


def lay(folder, count, mtime_s):
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(count):
        path = folder / f"{mtime_s}-{number}.json"
        path.write_bytes(b'{"kind":"cancel"}')
        os.utime(path, (mtime_s, mtime_s))


@pytest.mark.slow
def test_a_reader_looks_through_a_bounded_folder_however_many_requests_there_were(tmp_path, clock, monkeypatch):
    lay(tmp_path / "done", 3 * DONE_KEPT, 1_000)
    reader = SignalReader(tmp_path)
    drop_signal(tmp_path, Signal(kind="cancel", session="last"), clock)
    take_signals(tmp_path)
    looked_at, scan = [], os.scandir
    monkeypatch.setattr(os, "scandir", lambda folder: looked_at.extend(entries := list(scan(folder))) or iter(entries))

    assert [signal.session for signal in reader.read_new()] == ["last"]
    assert len(looked_at) <= DONE_KEPT
    monkeypatch.undo()
    assert sum(1 for _ in (tmp_path / "archive").iterdir()) == 2 * DONE_KEPT + 1


def test_what_a_slow_reader_may_not_have_seen_is_not_archived(tmp_path, clock, monkeypatch):
    monkeypatch.setattr(mailbox, "DONE_KEPT", 3)
    reader = SignalReader(tmp_path)
    for number in range(9):
        drop_signal(tmp_path, Signal(kind="cancel", session=str(number)), clock)
    take_signals(tmp_path)

    assert len(reader.read_new()) == 9


def fill_disk(monkeypatch):
    def refuse(path, *_, **__):
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr(Path, "touch", refuse)
    monkeypatch.setattr(Path, "write_text", refuse)


def test_on_a_full_disk_a_stop_is_told_at_once_and_everything_else_waits(tmp_path, clock, monkeypatch):
    drop_signal(tmp_path, Signal(kind="estop"), clock)
    drop_signal(tmp_path, Signal(kind="cancel"), clock)
    (tmp_path / "new" / "garbage").write_text("garbage")
    make_old(tmp_path / "new" / "garbage")
    with monkeypatch.context() as full:
        fill_disk(full)
        assert [signal.kind for signal in take_signals(tmp_path)] == ["estop"]
        assert len(list((tmp_path / "new").iterdir())) == 3

    assert [signal.kind for signal in take_signals(tmp_path)] == ["estop", "cancel"]
    assert not list((tmp_path / "new").iterdir())


def test_a_link_is_put_aside_and_no_word_of_what_it_leads_to_is_told(tmp_path):
    secret = tmp_path / "secret"
    secret.write_text("password: [hunter2\n")
    make_old(secret)
    path = tmp_path / "new" / "link.yaml"
    path.parent.mkdir()
    path.symlink_to(secret)
    (tmp_path / "rejected").mkdir()
    (tmp_path / "rejected" / "link.yaml.reason.txt").symlink_to(secret)
    os.utime(path, ns=(0, 0), follow_symlinks=False)

    assert take_signals(tmp_path) == []
    assert "hunter2" not in (tmp_path / "rejected" / "link.yaml.reason.txt").read_text()
    assert secret.read_text() == "password: [hunter2\n"
