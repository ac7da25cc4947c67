"""Temporary folders and the signals that come while one is made."""

import os
import signal
from pathlib import Path

import pytest

from phyagentos.scratch import open_scratch


def test_a_folder_is_removed_although_a_signal_came_right_after_it_was_made(tmp_path, monkeypatch):
    make = os.mkdir

    def make_and_interrupt(path, *rest, **options):
        make(path, *rest, **options)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(os, "mkdir", make_and_interrupt)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it
    try:
        with pytest.raises(KeyboardInterrupt), open_scratch():
            pytest.fail("the block was entered")
    finally:
        signal.signal(signal.SIGINT, before)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_this_users_alone_and_ends_with_its_block(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with open_scratch() as folder:
        assert folder.stat().st_mode & 0o777 == 0o700
        (folder / "file").write_text("kept until the end", encoding="utf-8")
        assert list(tmp_path.iterdir()) == [folder]
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_reported(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "absent"))
    with pytest.raises(FileNotFoundError), open_scratch():
        pytest.fail("the block was entered")
    assert Path(tmp_path / "absent").exists() is False
