"""Evidence folders that were made ahead."""

import threading

from phyagentos.runtime.blanks import PATIENCE, Blanks


def wait_until(ready) -> None:
    pause = threading.Event()
    while not ready():
        pause.wait(0.01)


def test_a_blank_becomes_the_folder_and_another_is_made(tmp_path):
    blanks = Blanks(tmp_path / "blanks", ("a.json", "b.json"), ahead=2)
    for name in ("first", "second", "third"):
        wait_until(lambda name=name: blanks.take(tmp_path / name))

        assert sorted(path.name for path in (tmp_path / name).iterdir()) == ["a.json", "b.json"]


def test_no_more_are_made_than_are_wanted(tmp_path):
    Blanks(tmp_path / "blanks", ("a.json",), ahead=3)
    wait_until(lambda: len(list((tmp_path / "blanks").glob("*/*"))) == 3)
    threading.Event().wait(0.05)

    assert len(list((tmp_path / "blanks").glob("*/*"))) == 3


def test_a_folder_that_holds_something_is_never_replaced(tmp_path):
    blanks = Blanks(tmp_path / "blanks", ("a.json",), ahead=1)
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "kept").write_text("x")
    wait_until(lambda: list((tmp_path / "blanks").glob("*/*/a.json")))

    assert not blanks.take(tmp_path / "there")
    assert [path.name for path in (tmp_path / "there").iterdir()] == ["kept"]
    wait_until(lambda: blanks.take(tmp_path / "free"))


def test_what_an_earlier_worker_left_is_removed(tmp_path):
    (tmp_path / "blanks" / "old").mkdir(parents=True)
    Blanks(tmp_path / "blanks", ("a.json",), ahead=1)

    assert not (tmp_path / "blanks" / "old").exists()


def test_what_nobody_took_is_removed_at_the_end(tmp_path):
    blanks = Blanks(tmp_path / "blanks", ("a.json",), ahead=1)
    wait_until(lambda: list((tmp_path / "blanks").glob("*/*/a.json")))
    blanks.close()

    assert not (tmp_path / "blanks").exists()
    assert not blanks.take(tmp_path / "first")


def test_a_place_that_has_become_slow_is_left_for_another(tmp_path, monkeypatch):
    monkeypatch.setattr("phyagentos.runtime.blanks.SLOW_S", -1.0)
    blanks = Blanks(tmp_path / "blanks", ("a.json",), ahead=PATIENCE + 1)
    wait_until(lambda: len(list((tmp_path / "blanks").glob("*/*/a.json"))) == PATIENCE + 1)

    assert len(list((tmp_path / "blanks").iterdir())) == 2
    assert blanks.take(tmp_path / "taken")
