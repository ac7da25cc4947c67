"""A file that is rendered and edited at the same time: every version of another writer is found once."""

import os

import pytest

from phyagentos.store import shared_file
from phyagentos.store.shared_file import GRACE_S, MISSING_S, SharedFile
from tests.protocol.test_regular_files import lay_sparse

MARK = "<!-- end of view -->\n"


class Shelf:
    def __init__(self, folder, clock, **options):
        self.path, self.aside, self.clock = folder / "S.md", folder / ".edits", clock
        self.file = SharedFile(self.path, self.aside, clock, **options)
        self.found = []

    def put(self, text):
        return self.file.put(text + MARK)

    def take(self, after_s=0.0, **options):
        self.clock.advance(after_s)
        self.file.take(lambda data, is_whole: self.found.append((data.decode(), is_whole)), **options)
        return self.found

    def aside_files(self):
        return [path for path in self.aside.iterdir() if path.suffix == ".md"]


@pytest.fixture
def shelf(tmp_path, clock):
    shelf = Shelf(tmp_path, clock)
    shelf.put("one\n")
    return shelf


def refuse(one, other):
    if not other.exists():
        raise FileNotFoundError(2, "nothing there")
    raise OSError(22, "no exchange here")


@pytest.fixture(params=["one step", "three steps"])
def any_shelf(shelf, request, monkeypatch):
    if request.param == "three steps":
        monkeypatch.setattr(shared_file, "exchange", refuse)
    return shelf


def test_what_no_one_touched_is_found_by_no_one(any_shelf):
    for _ in range(5):
        any_shelf.put("two\n")
        assert any_shelf.take(0.5) == []
        assert not any_shelf.file.is_touched()
    any_shelf.take(2.0)

    assert any_shelf.path.read_text() == "two\n" + MARK
    assert any_shelf.aside_files() == []


def test_a_file_that_was_renamed_over_is_found_once(any_shelf):
    other = any_shelf.path.with_name("tmp")
    other.write_text("theirs\n" + MARK)
    other.replace(any_shelf.path)
    assert any_shelf.file.is_touched()
    any_shelf.put("two\n")

    any_shelf.take()
    any_shelf.take(2.0)
    assert any_shelf.found == [("theirs\n" + MARK, True)]


def test_a_file_that_is_written_in_place_is_found_when_its_writer_has_closed_it(any_shelf):
    with any_shelf.path.open("w") as writer:
        any_shelf.put("two\n")
        writer.write("the")
        writer.flush()
        assert any_shelf.take(3.0) == []
        writer.write("irs\n" + MARK)
        writer.flush()
        assert any_shelf.take(3.0) == []
        writer.write("and more\n")
    any_shelf.take(0.1)

    assert any_shelf.found == [("theirs\n" + MARK + "and more\n", True)]
    assert any_shelf.path.read_text() == "two\n" + MARK


def test_a_file_that_was_moved_away_is_waited_for(any_shelf):
    any_shelf.path.rename(any_shelf.path.with_name("S.md~"))
    assert any_shelf.file.is_touched()
    assert not any_shelf.put("two\n")
    assert not any_shelf.path.exists()
    any_shelf.path.write_text("theirs\n" + MARK)
    assert any_shelf.put("two\n")

    assert any_shelf.take() == [("theirs\n" + MARK, True)]


def test_a_file_that_stays_away_is_put_back(any_shelf):
    any_shelf.path.unlink()
    assert not any_shelf.put("two\n")
    any_shelf.clock.advance(MISSING_S)

    assert any_shelf.put("two\n")
    assert any_shelf.path.read_text() == "two\n" + MARK
    assert any_shelf.take(2.0) == []


def test_a_save_that_is_given_up_is_handed_over_as_unfinished(shelf):
    shelf.path.write_text("half a fi")
    shelf.put("two\n")
    assert shelf.take() == []

    assert shelf.take(2.0) == [("half a fi", False)]
    assert shelf.aside_files() == []


def test_a_writer_that_never_closes_is_given_up_after_the_grace(shelf):
    with shelf.path.open("w") as writer:
        writer.write("half")
        writer.flush()
        shelf.put("two\n")
        assert shelf.take(GRACE_S - 1) == []
        assert shelf.take(2.0) == [("half", False)]


def test_a_change_that_leaves_size_and_time_as_they_were_is_found_with_the_next_rendering(shelf):
    before = shelf.path.stat()
    shelf.path.write_text("oNe\n" + MARK)
    os.utime(shelf.path, ns=(before.st_atime_ns, before.st_mtime_ns))
    shelf.put("two\n")

    assert shelf.take(2.0) == [("oNe\n" + MARK, True)]


def test_what_a_killed_process_had_in_its_hands_is_found_by_the_next(tmp_path, clock):
    first = Shelf(tmp_path, clock)
    first.put("one\n")
    first.path.write_text("theirs\n" + MARK)
    first.put("two\n")
    (left,) = first.aside_files()
    second = Shelf(tmp_path, clock)
    second.file.adopt()
    assert second.take(2.0) == [], "its owner is alive"
    left.rename(left.with_name(f"{os.getpid()}.1-00000001.md"))  # of an earlier process with the same number

    second.file.adopt()
    assert second.take() == [("theirs\n" + MARK, True)]
    assert second.aside_files() == []


def test_a_process_knows_what_the_one_before_put_in(tmp_path, clock):
    Shelf(tmp_path, clock).put("one\n")
    second = Shelf(tmp_path, clock)
    second.put("two\n")
    assert second.take(2.0) == []

    second.path.write_text("theirs\n" + MARK)
    third = Shelf(tmp_path, clock)
    third.put("three\n")
    assert third.take(2.0) == [("theirs\n" + MARK, True)]


def test_a_rendering_that_the_process_before_held_last_is_no_edit(tmp_path, clock):
    first = Shelf(tmp_path, clock)
    for text in ("one\n", "two\n", "three\n"):
        first.put(text)  # too fast for a look at what came out
    for path in first.aside_files():
        path.rename(path.with_name(f"{os.getpid()}.1-{path.name.partition('-')[2]}"))
    second = Shelf(tmp_path, clock)
    second.file.adopt()
    assert second.take() == []
    assert second.aside_files() == []


def test_what_was_not_dealt_with_stays(shelf):
    shelf.path.write_text("theirs\n" + MARK)
    shelf.put("two\n")

    def fail(data, is_whole):
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        shelf.file.take(fail)
    assert shelf.take(2.0) == [("theirs\n" + MARK, True)]


def test_no_process_swaps_while_another_one_holds_the_file(shelf):
    other = SharedFile(shelf.path, shelf.aside, shelf.clock)
    with other.hold(wait=True):
        assert not shelf.put("two\n")
    assert shelf.put("two\n")


def test_a_file_system_without_leases_is_given_time(shelf, monkeypatch):
    monkeypatch.setattr(shared_file, "may_be_written", lambda _: None)
    shelf.path.write_text("theirs\n" + MARK)
    shelf.put("two\n")

    assert shelf.take(2.0) == []
    assert shelf.take(5.0) == [("theirs\n" + MARK, True)]


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (os.mkfifo, "no regular file"),
        (lambda path: path.symlink_to(path.name), "symbolic link"),
        (lambda path: path.mkdir(), "no regular file"),
        (lay_sparse, "more than"),
    ],
)
def test_what_is_no_small_regular_file_is_kept_aside_with_the_reason_and_replaced(tmp_path, clock, make, reason):
    unfit = []
    shelf = Shelf(tmp_path, clock, on_unfit=lambda path, reason: unfit.append((path, reason)))
    shelf.put("one\n")
    shelf.path.unlink()
    make(shelf.path)
    assert shelf.file.is_touched()
    shelf.put("two\n")

    assert shelf.take(2.0) == []
    assert shelf.path.read_text() == "two\n" + MARK
    ((path, told),) = unfit
    assert reason in told
    assert os.path.lexists(path)
    assert reason in path.with_suffix(".reason.txt").read_text()
    shelf.file.adopt()
    assert shelf.take(2.0) == []
    assert len(unfit) == 1
