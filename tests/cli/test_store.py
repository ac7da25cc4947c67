"""`paos store`: what a person does with a journal that may be damaged."""

import json
import shutil

import pytest

from phyagentos.protocol.sessions.lifecycle import Side
from tests.command_line import assert_ended, assert_refused
from tests.store.damage import segments_of, spoil


def segment_of(run):
    (path,) = segments_of(run.pens[Side.AGENT])
    return path


@pytest.mark.slow
def test_every_problem_is_told_with_its_place_and_the_exit_code_is_1(paos, replanned):
    path = segment_of(replanned)
    places = [spoil(path, 4), spoil(path, 9)]

    done = paos("store", "check", replanned.workspace.root)
    told = paos("store", "check", replanned.workspace.root, "--json")

    assert done.code == told.code == 1
    assert [line.split(": ")[0] for line in done.out.splitlines()] == [f"{path.stem}:{place}" for place in places]
    assert "record 4 is lost" in done.out
    assert "damaged; see `paos store repair`" in done.err
    facts = json.loads(told.out)
    assert [(each["code"], each["offset"]) for each in facts["findings"]] == [
        ("JOURNAL_DAMAGED", place) for place in places
    ]
    assert (facts["is_whole"], facts["records"]) == (False, 18)


def test_a_torn_end_is_cut_without_asking(paos, replanned):
    path = segment_of(replanned)
    with path.open("ab") as file:
        file.write(b"<!-- phy1 0000000021 000900 00000000 -->\n- half of")
    assert paos("store", "check", replanned.workspace.root).code == 0

    assert_ended(
        paos("store", "repair", replanned.workspace.root),
        0,
        out=["50 bytes", "a torn end, which was never acknowledged"],
    )
    assert json.loads(paos("store", "check", replanned.workspace.root, "--json").out)["last_seq"] == 21


def test_damage_is_mended_only_when_the_loss_is_accepted(paos, replanned, read_with_node):
    path = segment_of(replanned)
    spoil(path, 9)
    damaged = path.read_bytes()

    assert_ended(
        paos("store", "repair", replanned.workspace.root), 1, out=["record 9 is lost"], err=["Nothing was changed"]
    )
    assert path.read_bytes() == damaged
    done = paos("store", "repair", replanned.workspace.root, "--accept-loss", "--json")

    facts = json.loads(done.out)
    assert (done.code, facts["is_done"], facts["lost"]) == (0, True, 1)
    assert facts["concerns"] == ["tidy-7.red"]
    assert path.with_name(f"{path.name}.damaged").read_bytes() == damaged
    assert paos("store", "check", replanned.workspace.root).code == 0
    (other,) = read_with_node(replanned.workspace.root)
    found = json.loads(paos("store", "check", replanned.workspace.root, "--json").out)
    assert (found["sha256"], found["last_seq"], found["records"]) == (other["sha256"], other["seq"], other["records"])


def test_what_only_reads_means_the_newest_workspace_and_names_it(paos, replanned, monkeypatch):
    root = replanned.workspace.root
    monkeypatch.chdir(root)
    named, newest = paos("store", "check", root), paos("store", "check")

    assert (newest.code, newest.out) == (named.code, named.out)
    assert newest.err == f"workspace . (the newest of 1)\n{named.err}"
    monkeypatch.chdir(root / "sessions")
    assert_refused(paos("store", "check"), "NOT_A_WORKSPACE")
    assert "WORKSPACE" in paos("store", "repair").err, "what writes is told where"


def test_what_nothing_needs_is_archived(paos, replanned, read_with_node):
    before = read_with_node(replanned.workspace.root)
    replanned.end("success")

    done = paos("store", "compact", replanned.workspace.root)
    again = paos("store", "compact", replanned.workspace.root, "--json")

    assert "1 segments archived; checkpoint at record 21" in done.out
    assert json.loads(again.out)["archived"] == []
    facts = json.loads(paos("store", "check", replanned.workspace.root, "--json").out)
    assert (facts["segments"], facts["last_seq"], facts["is_whole"]) == (2, before[0]["seq"] + 1, True)
    assert read_with_node(replanned.workspace.root)[0]["sha256"] == facts["sha256"]


def test_compacting_a_damaged_journal_is_refused(paos, replanned):
    path = segment_of(replanned)
    spoil(path, 9)

    assert_ended(paos("store", "compact", replanned.workspace.root), 4, err=["JOURNAL_DAMAGED"])
    assert path.exists()


@pytest.mark.parametrize("command", ["check", "repair", "compact"])
def test_a_folder_that_holds_no_journal_is_named(paos, replanned, tmp_path, command):
    assert_refused(paos("store", command, tmp_path), "NOT_A_WORKSPACE")
    assert_refused(paos("store", command, replanned.workspace.root, "--lane", "elsewhere"), "NOT_A_WORKSPACE")


def test_a_lane_can_be_named(paos, replanned):
    folder = replanned.pens[Side.AGENT].folder
    shutil.copytree(folder, folder.with_name("other"))

    assert_ended(
        paos("store", "check", replanned.workspace.root, "--lane", "other"),
        1,
        out=[f"JOURNAL_DAMAGED: lane is {folder.name}, expected other"],
    )
