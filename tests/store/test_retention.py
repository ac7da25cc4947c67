"""Evidence is thinned by policy, never silently: manifests tell what is gone, and nothing that is needed goes."""

import hashlib
import json
import os
from functools import partial
from types import SimpleNamespace

import msgspec
import pytest
from filelock import FileLock

from phyagentos.assembly.runtime_plane import EvidenceKeeper
from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.sessions import evidence
from phyagentos.protocol.sessions.evidence_manifest import (
    MANIFEST,
    OBJECTS,
    check_bundle,
    iter_objects,
    read_manifest,
)
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.verdicts import Verdict
from phyagentos.protocol.settings.runtime_contract import EvidenceRetention
from phyagentos.store import retention
from phyagentos.store.compaction import compact_partition
from phyagentos.store.journal import choose_partition
from phyagentos.store.retention import apply_retention
from phyagentos.store.segments import SystemIO

from .evidence_bundles import DAY_S, EVERYTHING, HEAVY, MODEL, SMALL, Store, names_in, read_all


def test_a_succeeded_session_is_thinned_and_its_manifest_says_so(store):
    folder = store.run("g.a")
    before = read_manifest(folder)
    report = store.prune()
    after = read_manifest(folder)

    assert names_in(folder) == {*SMALL, evidence.SCENE_MODEL, evidence.SCENE_XML, MANIFEST}
    [thinning] = after.thinned
    assert thinning.files == {name: before.files[name] for name in HEAVY}
    assert (thinning.at, thinning.rule) == (store.clock.wall_iso(), "keep_last 0, keep_days 0")
    assert thinning.policy == EVERYTHING.model_dump(mode="json")
    assert after.outcome.attempts[0].criteria[0].measured == {"margin_m": 0.05}
    assert [(each.session, set(each.files)) for each in report.thinned] == [("g.a", HEAVY)]
    assert store.check() == []


def test_the_running_plane_thins_after_so_many_sessions_that_ended(store):
    shipped = (find_shipped_root() / "protocol" / "runtime_contract.yaml").read_text()
    store.workspace.runtime_contract.write_text(shipped.replace("keep_last: 200", "keep_last: 0"))
    folder = store.run("g.a")
    whole = names_in(folder)
    store.clock.advance(365 * DAY_S)
    keeper = EvidenceKeeper(store.workspace, store.clock, every=2)
    for to in ("running", "succeeded"):
        keeper.take_in(SimpleNamespace(to=to))
        keeper.refresh()
    assert not (store.workspace.logs / "prune.log").exists()

    keeper.take_in(SimpleNamespace(to="failed"))
    keeper.refresh()
    keeper._thread.join(60.0)

    report = (store.workspace.logs / "prune.log").read_text()
    assert names_in(folder) == whole - HEAVY, report
    assert msgspec.json.decode(report)["thinned"][0]["session"] == "g.a"
    keeper.close()


def test_a_plane_that_ends_ends_its_clean_up_between_two_bundles(store):
    """Wherever it ends: what is marked as gone is gone, and the next clean-up takes the rest."""
    folders = [store.run("g.a"), store.run("g.b")]
    for turns in range(9):
        left = iter(range(turns))
        goes_on = partial(next, left, None)  # a turn, or None when all are taken
        apply_retention(store.workspace, EVERYTHING, store.clock, goes_on=lambda ask=goes_on: ask() is not None)
        assert store.check() == []
        if turns == 0:
            assert all(names_in(folder) >= HEAVY for folder in folders)
    store.prune()

    assert not any(names_in(folder) & HEAVY for folder in folders)


@pytest.mark.parametrize("key", ["files", "thinned"])
def test_a_manifest_names_no_file_outside_of_its_bundle(store, tmp_path, key):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    folder = store.run("g.a")
    (folder / "look-").mkdir()
    name = "look-/../../../../victim"
    assert (folder / name).samefile(victim)
    data = json.loads((folder / MANIFEST).read_text())
    entry = {name: {"sha256": hashlib.sha256(b"precious").hexdigest(), "bytes": 8}}
    if key == "files":
        data["files"] |= entry
    else:
        data["thinned"] = [{"at": "", "rule": "", "policy": {}, "files": entry}]
    (folder / MANIFEST).write_text(json.dumps(data))
    report = store.prune()

    assert victim.read_text() == "precious"
    assert report.damaged == ("g.a",)
    assert "EVIDENCE_DAMAGED" in str(check_bundle(folder))


ALL_OVER = EvidenceRetention(keep_last=0, keep_days=0, max_bytes=1)


def test_failed_and_replanned_sessions_stay_whole(store):
    folders = [store.run("g.a", Verdict.FAILURE), store.run("g.b", Verdict.REPLAN)]
    before = list(map(names_in, folders))
    report = store.prune(ALL_OVER)
    assert list(map(names_in, folders)) == before
    assert (report.thinned, report.whole, report.bytes_over) == ((), 2, report.bytes_after - 1)


@pytest.mark.parametrize(
    ("is_judged", "after_s"),
    [
        pytest.param(False, 1000 * DAY_S, id="a running session is never touched"),
        pytest.param(True, retention.GRACE_S / 2, id="nor one that was judged this very moment"),
    ],
)
def test_a_session_that_may_still_be_written_is_not_touched(store, is_judged, after_s):
    folder = store.begin("g.a")
    if is_judged:
        store.end("g.a", seal=False)
    before = read_all(folder)
    store.clock.advance(after_s)
    assert store.prune(ALL_OVER).thinned == ()
    assert read_all(folder) == before


def test_sessions_of_a_goal_that_goes_on_are_not_touched(store):
    store.write(Side.AGENT, "goal:tidy-7", "goal_submitted", graph="tidy", seed=7, objective="Tidy up.")
    store.run("tidy-7.red")
    assert store.prune().thinned == ()

    store.write(Side.AGENT, "goal:tidy-7", "goal_verdict", verdict="success", criteria=[], reason="because")
    assert len(store.prune().thinned) == 1


@pytest.mark.parametrize(
    ("policy", "thinned"),
    [
        (EvidenceRetention(keep_last=4, keep_days=0), ["g.a", "g.b"]),
        (EvidenceRetention(keep_last=0, keep_days=4.5), ["g.a", "g.b"]),
        (EvidenceRetention(keep_last=6, keep_days=0), []),
    ],
)
def test_the_newest_and_the_youngest_stay_whole(store, policy, thinned):
    for name in "abcdef":  # one a day
        store.run(f"g.{name}")
    assert [each.session for each in store.prune(policy, dry_run=True).thinned] == thinned


def test_a_cap_takes_from_the_oldest_on_until_the_rest_fits_and_models_last(store):
    for name in "abc":
        store.run(f"g.{name}")
    kept = EvidenceRetention(keep_last=100)
    total = store.prune(kept).bytes_after
    capped = EvidenceRetention(keep_last=100, max_bytes=total - 1)
    report = store.prune(capped)

    assert [each.session for each in report.thinned] == ["g.a"]
    assert report.thinned[0].rule == f"max_bytes {total - 1}"
    assert report.bytes_after < total
    last = store.prune(EvidenceRetention(keep_last=100, max_bytes=1000))
    assert {evidence.SCENE_MODEL} <= {name for each in last.thinned for name in each.files}
    assert list(iter_objects(store.workspace.evidence)) == []
    assert store.check() == []


def test_a_large_file_that_another_bundle_needs_is_kept(store):
    store.run("g.a")
    failed = store.run("g.b", Verdict.FAILURE)
    shared = (failed / evidence.PICTURE_BEFORE).read_bytes()
    store.prune(EvidenceRetention(keep_last=0, keep_days=0, drop=("pictures", "model")))

    digest = hashlib.sha256(shared).hexdigest()
    assert (store.workspace.evidence / OBJECTS / digest[:2] / f"{digest}.png").exists()
    assert (failed / evidence.SCENE_MODEL).read_bytes() == MODEL
    assert store.check() == []


def test_what_is_reported_is_what_is_freed(store):
    for name in "abc":
        store.run(f"g.{name}")
    foreseen = store.prune(dry_run=True)
    untouched = read_all(store.workspace.evidence)
    report = store.prune()

    def count():
        status = [path.stat() for path in store.workspace.evidence.rglob("*") if path.is_file()]
        manifests = sum(path.stat().st_size for path in store.workspace.evidence.rglob(MANIFEST))
        return sum({each.st_ino: each.st_size for each in status}.values()) - manifests

    assert len(untouched) > len(read_all(store.workspace.evidence))
    assert (foreseen.thinned, foreseen.bytes_after) == (report.thinned, report.bytes_after)
    grown = {path: len(data) for path, data in untouched.items() if path.name == MANIFEST}
    assert count() == report.bytes_after - sum(grown.values())


def test_a_bundle_whose_worker_died_before_sealing_it_is_sealed_late_and_says_so(store):
    folder = store.run("g.a", Verdict.FAILURE, seal=False)
    report = store.prune()

    assert report.sealed_late == ("g.a",)
    assert read_manifest(folder).sealed_late
    assert check_bundle(folder) == []


def test_nothing_is_taken_out_of_a_damaged_bundle(store):
    folder = store.run("g.a")
    (folder / evidence.HOLDS).write_bytes(b"[1]")
    before = read_all(folder)
    torn = store.run("g.b")
    (torn / MANIFEST).write_bytes(b"{")
    report = store.prune()

    assert set(report.damaged) == {"g.a", "g.b"}
    assert read_all(folder) == before


def test_a_bundle_that_no_session_belongs_to_is_left_alone(store):
    stranger = store.workspace.evidence / "g.stranger"
    stranger.mkdir()
    (stranger / evidence.TRACE).write_bytes(b"x")
    store.prune()

    assert names_in(stranger) == {evidence.TRACE}


def test_two_clean_ups_at_once_are_refused(store):
    with FileLock(store.workspace.evidence / ".retention.lock"), pytest.raises(ExecutionError, match="BUSY"):
        store.prune()


class Fault:
    """Lets the n-th call of several functions of `os` fail; everything after it too, as in a process that died."""

    def __init__(self, monkeypatch, at: int) -> None:
        self.calls, self.at = 0, at
        for name in ("unlink", "replace", "fsync", "link"):
            monkeypatch.setattr(os, name, self.guard(getattr(os, name)))

    def guard(self, real):
        def call(*arguments, **options):
            self.calls += 1
            if self.calls >= self.at:
                raise OSError(28, "No space left on device")
            return real(*arguments, **options)

        return call


def find_code(call):
    try:
        call()
    except ExecutionError as error:
        return error.code
    return ""


@pytest.mark.slow
def test_a_clean_up_that_dies_at_any_call_leaves_no_bundle_that_lacks_a_file_without_saying_so(tmp_path, submit):
    at = 1
    while True:
        store = Store(tmp_path / f"w{at}", submit)
        folders = [store.run("g.a"), store.run("g.b", seal=False), store.run("g.c", Verdict.FAILURE)]
        contents = {path: hashlib.sha256(data).hexdigest() for path, data in read_all(store.workspace.evidence).items()}
        with pytest.MonkeyPatch.context() as patch:
            fault = Fault(patch, at)
            died = find_code(store.prune)
        for folder in folders:
            manifest = read_manifest(folder)
            known = {} if manifest is None else manifest.gone | manifest.files
            for path in (path for path in contents if path.parent == folder and path.name != MANIFEST):
                if not path.exists():
                    assert known[path.name].sha256 == contents[path], f"{path} is gone and unnamed at call {at}"
                    assert path.name in manifest.gone
            assert [problem for problem in check_bundle(folder) if problem.code != "EVIDENCE_DAMAGED"] == []
        store.prune()
        assert store.check() == []
        assert not list(store.workspace.evidence.rglob("*.tmp"))
        assert not names_in(folders[0]) & HEAVY
        store.close()
        assert died in {"", "WRITE_FAILED"}
        if not died:
            assert fault.calls < at
            break
        at += 1
    assert at > 10


def test_sessions_whose_journal_is_archived_are_thinned_all_the_same(store):
    folder = store.run("g.a")
    store.close()
    lane = store.workspace.sessions / choose_partition(store.workspace.sessions)
    compact_partition(lane, by="test", clock=store.clock, file_io=SystemIO())
    assert list((store.workspace.sessions / "archive").rglob("*.md"))

    assert [each.session for each in store.prune().thinned] == ["g.a"]
    assert not names_in(folder) & HEAVY


def test_a_clean_up_that_cannot_begin_does_not_end_the_plane(store):
    (store.workspace.logs / "prune.log").mkdir()
    keeper = EvidenceKeeper(store.workspace, store.clock, every=1)
    keeper.take_in(SimpleNamespace(to="failed"))
    keeper.refresh()
    keeper.close()
