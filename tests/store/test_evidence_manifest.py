"""A sealed bundle is an ordinary folder whose every file can be checked; large files are kept once."""

import hashlib
import os
from pathlib import Path

import pytest

from phyagentos.protocol.sessions import evidence
from phyagentos.protocol.sessions.evidence_manifest import (
    MANIFEST,
    OBJECTS,
    Sealer,
    check_bundle,
    iter_objects,
    read_manifest,
    unseal_bundle,
)

from .evidence_bundles import HEAVY, MODEL, names_in


def test_equal_large_files_are_stored_once_and_every_bundle_stays_a_folder_of_ordinary_files(store):
    first, second = store.run("g.a"), store.run("g.b")

    assert (first / evidence.SCENE_MODEL).samefile(second / evidence.SCENE_MODEL)
    assert (first / evidence.PICTURE_BEFORE).samefile(second / evidence.PICTURE_BEFORE)
    assert (second / evidence.SCENE_MODEL).read_bytes() == MODEL
    assert not any(path.is_symlink() for path in second.iterdir())
    assert {path.suffix for path in iter_objects(store.workspace.evidence)} == {".mjb", ".png", ".xml"}


def test_an_object_lies_under_the_hash_of_its_bytes(store):
    store.run("g.a")
    digest = hashlib.sha256(MODEL).hexdigest()

    assert (store.workspace.evidence / OBJECTS / digest[:2] / f"{digest}.mjb").read_bytes() == MODEL
    assert store.check() == []


def test_a_damaged_object_is_not_handed_to_the_next_bundle(store):
    first = store.run("g.a")
    shared = first / evidence.SCENE_MODEL
    shared.chmod(0o644)
    shared.write_bytes(MODEL[:-1] + b"?")
    second = store.run("g.b")

    assert (second / evidence.SCENE_MODEL).read_bytes() == MODEL
    assert check_bundle(second) == []
    assert [Path(problem.address).name for problem in check_bundle(first)] == [evidence.SCENE_MODEL]


def test_a_bundle_that_is_written_again_does_not_change_the_others(store):
    first, second = store.run("g.a"), store.run("g.b")
    (second / evidence.HOLDS).chmod(0o444)
    unseal_bundle(second)
    assert all(path.stat().st_mode & 0o200 for path in second.iterdir())
    (second / evidence.PICTURE_BEFORE).write_bytes(b"another picture")

    assert check_bundle(first) == []
    assert check_bundle(second)[0].code == "EVIDENCE_DAMAGED"


@pytest.mark.parametrize(
    ("damage", "found", "hint"),
    [
        (lambda folder: (folder / evidence.TRACE).write_bytes(b"changed"), "sha256 ", ""),
        (lambda folder: (folder / evidence.HOLDS).unlink(), "no such file", ""),
        (lambda folder: (folder / "note.txt").write_bytes(b"mine"), "a file that the manifest does not name", ""),
        (lambda folder: (folder / MANIFEST).write_bytes(b"{"), "Input data was truncated", ""),
        (lambda folder: (folder / MANIFEST).unlink(), "no manifest.json", ""),
        pytest.param(
            lambda folder: (folder / evidence.SCENE_MODEL).unlink(),
            "no such file",
            f"{OBJECTS}/{hashlib.sha256(MODEL).hexdigest()[:2]}",
            id="a large file that is among the objects",
        ),
    ],
)
def test_a_change_of_a_sealed_bundle_is_found(store, damage, found, hint):
    folder = store.run("g.a")
    assert check_bundle(folder) == []
    damage(folder)
    (problem,) = check_bundle(folder)
    assert problem.code == "EVIDENCE_DAMAGED"
    assert (found in problem.found, hint in problem.hint) == (True, True)


def test_a_worker_that_seals_late_does_not_undo_what_a_clean_up_has_written(store, monkeypatch):
    folder = store.run("g.a", seal=False)
    pruned = []

    def read_slowly(path, real=Path.read_bytes):
        data = real(path)
        if path.name == evidence.TRAJECTORY and not pruned:  # the last one
            pruned.append(True)
            store.prune()
        return data

    monkeypatch.setattr(Path, "read_bytes", read_slowly)
    manifest = store.sealer.seal(folder)
    monkeypatch.undo()

    assert manifest == read_manifest(folder)
    assert set(manifest.gone) == HEAVY
    store.prune()
    assert check_bundle(folder) == []
    assert not names_in(folder) & HEAVY


def test_a_file_system_without_links_keeps_whole_bundles(store, monkeypatch):
    def refuse(*_: object, **__: object) -> None:
        raise OSError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", refuse)
    first, second = store.run("g.a"), store.run("g.b")
    monkeypatch.undo()

    assert list(iter_objects(store.workspace.evidence)) == []
    assert (second / evidence.SCENE_MODEL).stat().st_nlink == 1
    assert check_bundle(first) == check_bundle(second) == []
    assert [path.name for path in store.workspace.evidence.rglob(".*.tmp")] == []


@pytest.mark.parametrize("model", [MODEL, b"small"])
def test_a_model_is_read_once_however_many_sessions_share_it(tmp_path, monkeypatch, model):
    read = []
    real = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda path: (read.append(path.name), real(path))[1])
    sealer = Sealer(tmp_path)
    for number in range(40):
        folder = tmp_path / f"g.{number}"
        folder.mkdir()
        for name in (evidence.PICTURE_BEFORE, evidence.PICTURE_AFTER):
            (folder / name).write_bytes(f"{name} {number}".encode() * 10_000)
        if number:
            (folder / evidence.SCENE_MODEL).hardlink_to(tmp_path / "g.0" / evidence.SCENE_MODEL)
        else:
            (folder / evidence.SCENE_MODEL).write_bytes(model)
            (tmp_path / evidence.SCENE_MODEL).hardlink_to(folder / evidence.SCENE_MODEL)
        sealer.seal(folder)

    assert read.count(evidence.SCENE_MODEL) == 1
    assert read.count(evidence.PICTURE_AFTER) == 40
