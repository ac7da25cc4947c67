"""Evidence folders that were made ahead."""

import os

from phyagentos.protocol.sessions.evidence import EXECUTION
from phyagentos.runtime.worker.blanks import PATIENCE, Blanks
from phyagentos.runtime.worker.recorder import WRITTEN, Recorder


def never() -> bool:
    return False


def list_blanks(folder) -> list:
    return list(folder.glob("*/*"))


def test_a_blank_becomes_the_folder_and_another_is_made(tmp_path):
    blanks = Blanks(tmp_path / "blanks", ("a.json", "b.json"), ahead=2)
    for name in ("first", "second", "third"):
        blanks.fill(never)

        assert blanks.take(tmp_path / name) == ("a.json", "b.json")
        assert sorted(path.name for path in (tmp_path / name).iterdir()) == ["a.json", "b.json"]


def test_no_more_are_made_than_are_wanted(tmp_path):
    blanks = Blanks(tmp_path / "blanks", ("a.json",), ahead=3)
    blanks.fill(never)
    blanks.fill(never)

    assert len(list_blanks(tmp_path / "blanks")) == 3


def test_making_them_gives_way_to_whoever_asks(tmp_path):
    blanks = Blanks(tmp_path / "blanks", ("a.json",), ahead=9)
    asked = iter([False, False, True])
    blanks.fill(lambda: next(asked))

    assert len(list_blanks(tmp_path / "blanks")) == 2


def test_a_folder_without_files_is_made_at_once_where_none_was_made_ahead(tmp_path):
    blanks = Blanks(tmp_path / "blanks", ("a.json",), ahead=1)

    assert blanks.take(tmp_path / "first") == ()
    assert list((tmp_path / "first").iterdir()) == []


def test_a_folder_that_holds_something_is_never_replaced(tmp_path):
    blanks = Blanks(tmp_path / "blanks", ("a.json",), ahead=1)
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "kept").write_text("x")

    assert blanks.take(tmp_path / "there") is None
    assert [path.name for path in (tmp_path / "there").iterdir()] == ["kept"]
    assert blanks.take(tmp_path / "free") is not None


def test_what_an_earlier_worker_left_is_removed(tmp_path):
    (tmp_path / "blanks" / "old").mkdir(parents=True)
    Blanks(tmp_path / "blanks", ("a.json",), ahead=1)

    assert not (tmp_path / "blanks" / "old").exists()


def test_what_nobody_took_is_removed_at_the_end(tmp_path):
    blanks = Blanks(tmp_path / "blanks", ("a.json",), ahead=1)
    blanks.fill(never)
    blanks.close()

    assert not (tmp_path / "blanks").exists()
    assert blanks.take(tmp_path / "first") is None


def test_a_place_that_has_become_slow_is_left_for_another(tmp_path, monkeypatch):
    monkeypatch.setattr("phyagentos.runtime.worker.blanks.SLOW_S", -1.0)
    blanks = Blanks(tmp_path / "blanks", ("a.json",), ahead=PATIENCE + 1)
    blanks.fill(never)

    assert len(list((tmp_path / "blanks").iterdir())) == 2
    assert blanks.take(tmp_path / "taken")


def test_a_full_disk_leaves_the_folder_to_the_session(tmp_path, monkeypatch):
    blanks = Blanks(tmp_path / "blanks", ("a.json",), ahead=1)

    def refuse(*_args) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "mkdir", refuse)
    blanks.fill(never)

    assert blanks.take(tmp_path / "first") is None
    monkeypatch.undo()
    assert blanks.take(tmp_path / "first") is not None


def test_a_file_that_was_made_ahead_is_not_truncated_and_one_that_holds_something_is(tmp_path, monkeypatch):
    flags: list[int] = []
    system_open = os.open

    def note(path, how, *args, **options):
        flags.append(how & os.O_TRUNC)
        return system_open(path, how, *args, **options)

    blanks = Blanks(tmp_path / "blanks", WRITTEN, ahead=1)
    blanks.fill(never)
    recorder = Recorder(tmp_path / "bundle", blanks=blanks)
    monkeypatch.setattr("phyagentos.runtime.worker.recorder.os.open", note)
    recorder._write(EXECUTION, b"first, and long")
    recorder._write(EXECUTION, b"second")

    assert [bool(each) for each in flags] == [False, True]
    assert (tmp_path / "bundle" / EXECUTION).read_bytes() == b"second"
