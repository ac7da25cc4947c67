"""`paos evidence`: damage is found with its path, old successes are thinned, and a verdict stays explained."""

import json
import shutil
from pathlib import Path

import msgspec
import pytest

from phyagentos.cli.outcome import ExitCode
from phyagentos.protocol.sessions import evidence
from phyagentos.protocol.sessions.evidence_manifest import Sealer, keep_shown, read_manifest
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.sessions.verdicts import Attempt, Criterion, Verdict
from phyagentos.protocol.world.environment import Entity, Environment, Pose
from phyagentos.protocol.world.truth import Truth
from tests.command_line import assert_ended, assert_refused
from tests.looks import keep_look

PROTOCOL = Path(__file__).resolve().parents[2] / "protocol"
POLICY = "evidence:\n  keep_last: 0\n  keep_days: 1\n"


@pytest.fixture
def bundles(run):
    """One succeeded and one failed session of a goal that has ended, both sealed."""
    run.begin()
    sealer = Sealer(run.workspace.evidence)
    folders = []
    for node, verdict in (("red", Verdict.SUCCESS), ("blue", Verdict.FAILURE)):
        id = run.submit(node)
        run.execute(id)
        run.judge(id, verdict, Truth.TRUE if verdict is Verdict.SUCCESS else Truth.FALSE)
        folder = run.workspace.evidence_of(id)
        folder.mkdir()
        for name, data in ((evidence.HOLDS, b"[]"), (evidence.TRACE, b""), (evidence.PICTURE_AFTER, b"p" * 100_000)):
            (folder / name).write_bytes(data)
        sealer.seal(folder)
        folders.append(folder)
    run.end("failure")
    contract = (PROTOCOL / "runtime_contract.yaml").read_text().split("evidence:")[0] + POLICY
    run.workspace.runtime_contract.write_text(contract)
    return folders


def change_files(first, second):
    (first / evidence.HOLDS).write_bytes(b"[ ]")
    (second / evidence.TRACE).unlink()


def take_away(first, second):
    shutil.rmtree(first)
    second.rename(second.with_name("elsewhere.blue"))
    second.write_text("no folder")


@pytest.mark.parametrize(
    ("damage", "places", "found", "count"),
    [
        pytest.param(
            change_files,
            (f"tidy-7.red/{evidence.HOLDS}", f"tidy-7.blue/{evidence.TRACE}"),
            "",
            2,
            id="each mismatch is named with its path",
        ),
        pytest.param(
            take_away,
            ("tidy-7.red", "tidy-7.blue"),
            ": found no such folder; expected the bundle of tidy-7.",
            3,
            id="a bundle that is gone as a whole is named with its session",
        ),
    ],
)
def test_damage_is_named_with_its_path(paos, run, bundles, damage, places, found, count):
    damage(*bundles)
    result = paos("evidence", "verify", "-w", run.workspace.root)
    assert (result.code, result.out) == (ExitCode.GOAL_NOT_MET, f"{count} bundles checked: 2 problems\n")
    for place in places:
        assert f"{run.workspace.evidence / place}: EVIDENCE_DAMAGED{found}" in result.err


def test_a_session_that_runs_or_left_no_bundle_misses_none(paos, run):
    run.begin()
    id = run.submit("red")
    run.workspace.evidence_of(id).mkdir()
    verify = ("evidence", "verify", "-w", run.workspace.root)
    running = paos(*verify)
    run.workspace.evidence_of(id).rmdir()
    run.execute(id, Ended.TARGET_LOST)
    run.judge(id, Verdict.FAILURE, Truth.FALSE)
    run.write(Side.AGENT, run.submit("blue"), "cancel")
    run.end("failure")
    for result in (running, paos(*verify)):
        assert (result.code, result.out) == (ExitCode.GOAL_MET, "0 bundles checked: as recorded\n")


def test_a_damaged_large_file_is_named_in_every_bundle_that_shares_it(paos, run, bundles):
    shared = bundles[0] / evidence.PICTURE_AFTER
    shared.chmod(0o644)
    shared.write_bytes(b"q" * 100_000)
    result = paos("evidence", "verify", "--json", "-w", run.workspace.root)

    assert result.code == ExitCode.GOAL_NOT_MET
    problems = json.loads(result.out)["problems"]
    assert {problem["code"] for problem in problems} == {"EVIDENCE_DAMAGED"}
    assert len(problems) == 3  # both bundles, and the object


@pytest.fixture
def seen(run):
    """The bundle of a session whose snapshot points into the picture that it was perceived from."""
    run.begin()
    id = run.submit("red")
    run.execute(id)
    run.judge(id, Verdict.SUCCESS, Truth.TRUE)
    folder = run.workspace.evidence_of(id)
    folder.mkdir()
    keep_look(folder, "end", {"top": b"png"}, time_s=9.0)
    cube = Entity(name="cube", kind="cube", pose=Pose(), evidence=("top@9.000:180,10,12,20",))
    facts = {"time_s": 9.0, "scene": "s", "episode": "e", "revision": 1, "sensing": "perceived"}
    evidence.write_json(folder / evidence.AFTER, Environment(entities={"cube": cube}, **facts))
    return folder


def point_beyond(folder):
    path = folder / evidence.AFTER
    path.write_text(path.read_text().replace("180,10,12,20", "181,10,12,20"))


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        pytest.param(lambda _: None, "", id="a pointer that leads to pixels is sound"),
        pytest.param(
            point_beyond, ": cube: EVIDENCE_DAMAGED: found top@9.000:181,10,12,20", id="a pointer beyond its picture"
        ),
        pytest.param(
            lambda folder: (folder / "look-end.zip").unlink(),
            "/look-end.zip: EVIDENCE_DAMAGED",
            id="a look that is gone is named also where no manifest lists it",
        ),
    ],
)
def test_a_pointer_of_a_snapshot_leads_to_pixels(paos, run, seen, damage, said):
    damage(seen)
    Sealer(run.workspace.evidence).seal(seen)
    result = paos("evidence", "verify", "-w", run.workspace.root)
    assert result.code == (ExitCode.GOAL_NOT_MET if said else ExitCode.GOAL_MET), result.err
    assert f"{seen}{said}" in result.err if said else result.out == "1 bundle checked: as recorded\n"


def test_looks_that_a_clean_up_took_are_not_missed(paos, run, seen):
    Sealer(run.workspace.evidence).seal(seen)
    run.end("success")
    contract = (PROTOCOL / "runtime_contract.yaml").read_text().split("evidence:")[0] + POLICY
    run.workspace.runtime_contract.write_text(contract)
    assert paos("evidence", "prune", "-w", run.workspace.root).code == ExitCode.GOAL_MET
    assert not (seen / "look-end.zip").exists()
    assert paos("evidence", "verify", "-w", run.workspace.root).code == ExitCode.GOAL_MET


def test_a_dry_run_tells_what_would_go_and_takes_nothing(paos, run, bundles):
    before = sorted(run.workspace.evidence.rglob("*"))
    assert_ended(
        paos("evidence", "prune", "--dry-run", "-w", run.workspace.root),
        ExitCode.GOAL_MET,
        out=["tidy-7.red: would take after.png, trace.jsonl (keep_last 0, keep_days 1)", "1 thinned, 1 whole"],
    )
    assert sorted(run.workspace.evidence.rglob("*")) == before


def test_a_thinned_session_is_still_explained(paos, run, bundles):
    result = paos("evidence", "prune", "--json", "-w", run.workspace.root)
    report = json.loads(result.out)
    assert [each["session"] for each in report["thinned"]] == ["tidy-7.red"]
    assert read_manifest(bundles[0]).outcome.state == "succeeded"
    assert not (bundles[0] / evidence.PICTURE_AFTER).exists()
    assert (bundles[1] / evidence.PICTURE_AFTER).exists()

    told = paos("why", "red", "-w", run.workspace.root)
    assert "distance_m 0.31" in told.out
    assert "thinned     " in told.out
    assert "after.png, trace.jsonl (keep_last 0, keep_days 1)" in told.out
    assert paos("evidence", "verify", "-w", run.workspace.root).code == ExitCode.GOAL_MET


def test_a_wrong_policy_is_refused_with_its_place(paos, run, bundles):
    text = run.workspace.runtime_contract.read_text().replace("keep_last: 0", "keep_lats: 0")
    run.workspace.runtime_contract.write_text(text)
    assert_refused(
        paos("evidence", "prune", "-w", run.workspace.root),
        "UNKNOWN_NAME (key): found 'keep_lats'",
        "Did you mean 'keep_last'?",
    )
    assert paos("lint", run.workspace.runtime_contract).code == ExitCode.INVALID_INPUT


def test_a_context_that_a_model_was_shown_is_checked_with_the_bundle_that_holds_it(paos, run, bundles):
    sha256 = keep_shown(bundles[0], "# Context for verify\n")  # after it was sealed
    criterion = Criterion(text="inside(red_cube, red_tray)", kind="vision", truth=Truth.TRUE, shown=sha256)
    attempt = Attempt(verdict=Verdict.SUCCESS, criteria=(criterion,), is_review=True)
    run.write(Side.AGENT, bundles[0].name, "review", attempt=msgspec.to_builtins(attempt))
    shown = bundles[0] / "shown" / f"{sha256}.md"
    assert paos("evidence", "verify", "-w", run.workspace.root).code == ExitCode.GOAL_MET

    shown.write_text("# Context for nothing\n")
    assert_ended(
        paos("evidence", "verify", "-w", run.workspace.root), ExitCode.GOAL_NOT_MET, err=[f"{shown}: EVIDENCE_DAMAGED"]
    )
    shown.unlink()
    result = paos("evidence", "verify", "-w", run.workspace.root)
    assert f"{shown}: EVIDENCE_DAMAGED: found no such file; expected sha256 {sha256}" in result.err


def test_a_thinned_bundle_still_holds_what_a_model_was_shown(paos, run, bundles):
    sha256 = keep_shown(bundles[0], "# Context for verify\n")
    run.clock.advance(3 * 86_400.0)
    result = paos("evidence", "prune", "-w", run.workspace.root)
    assert result.code == ExitCode.GOAL_MET
    assert (bundles[0] / "shown" / f"{sha256}.md").is_file()
    assert paos("evidence", "verify", "-w", run.workspace.root).code == ExitCode.GOAL_MET
