"""Equal files of two bundles are one, and no bundle is changed by what happens to another."""

import os
from pathlib import Path

import pytest

from phyagentos.runtime.worker.bundle_files import BundleFiles


@pytest.fixture
def two(tmp_path):
    """The files of two bundles, one after the other; the first holds `a.json`."""
    for name in ("g.a", "g.b"):
        (tmp_path / name).mkdir()
    first = BundleFiles(tmp_path / "g.a")
    first.write("a.json", b"[]\n")
    return tmp_path / "g.a", tmp_path / "g.b", BundleFiles(tmp_path / "g.b", first)


def test_a_file_with_the_bytes_of_the_bundle_before_is_a_link_to_it(two):
    before, folder, files = two
    files.write("b.json", b"[]\n")
    files.write("c.json", b"{}\n")

    assert (folder / "b.json").samefile(before / "a.json")
    assert (folder / "c.json").read_bytes() == b"{}\n"
    assert (folder / "c.json").stat().st_nlink == 1


@pytest.mark.parametrize("change", ["altered", "replaced", "gone"])
def test_a_file_that_is_not_as_it_was_written_is_written_anew(two, change):
    before, folder, files = two
    if change == "altered":
        (before / "a.json").write_bytes(b"{}\n")
        os.utime(before / "a.json", ns=(0, 0))
    else:
        (before / "a.json").unlink()
    if change == "replaced":
        (before / "a.json").write_bytes(b"{}\n")
    files.write("b.json", b"[]\n")

    assert (folder / "b.json").read_bytes() == b"[]\n"


def test_a_file_that_is_written_again_leaves_the_other_bundle_as_it_is(two):
    before, folder, files = two
    files.write("b.json", b"[]\n")
    files.write("b.json", b"later\n")
    files.write("b.json", b"[]\n")
    files.write("b.json", b"latest\n")

    assert (before / "a.json").read_bytes() == b"[]\n"
    assert (folder / "b.json").read_bytes() == b"latest\n"


def test_without_links_every_bundle_has_its_own_files(two, monkeypatch):
    before, folder, files = two

    def refuse(*_):
        raise PermissionError("no links here")

    monkeypatch.setattr(Path, "hardlink_to", refuse)
    files.write("b.json", b"[]\n")

    assert (folder / "b.json").read_bytes() == b"[]\n"
    assert not (folder / "b.json").samefile(before / "a.json")
