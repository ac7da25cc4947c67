"""What no worker has sealed is sealed when the runtime plane ends."""

from phyagentos.assembly.runtime_plane import seal_rest
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.sessions import evidence
from phyagentos.protocol.sessions.evidence_manifest import check_bundle, read_manifest
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.verdicts import Verdict
from phyagentos.protocol.world.truth import Truth
from phyagentos.store import checkpoint
from phyagentos.store.ledger import FINISHED_KEPT


def test_bundles_that_a_worker_left_are_sealed_as_late_and_running_ones_are_not(run):
    run.begin()
    ended, running = run.submit("red"), run.submit("blue")
    run.execute(ended)
    for id in (ended, running):
        run.workspace.evidence_of(id).mkdir(parents=True)
        (run.workspace.evidence_of(id) / evidence.HOLDS).write_bytes(b"[]")

    seal_rest(run.workspace, read_ledger(run.workspace.root))

    assert check_bundle(run.workspace.evidence_of(ended)) == []
    assert read_manifest(run.workspace.evidence_of(ended)).sealed_late
    assert read_manifest(run.workspace.evidence_of(running)) is None


def test_the_look_ahead_of_a_refused_session_is_sealed_too(run):
    run.begin()
    id = run.submit("red")
    for event in ("claim", "check", "reject"):
        run.write(Side.RUNTIME, id, event)
    run.workspace.evidence_of(id).mkdir(parents=True)

    seal_rest(run.workspace, read_ledger(run.workspace.root))

    assert read_manifest(run.workspace.evidence_of(id)) is not None


def test_a_bundle_whose_session_is_long_over_is_sealed_too(run):
    """A ledger forgets it: the bundle that a lost worker left stayed without hashes."""
    run.begin()
    id = run.submit("red")
    run.execute(id)
    run.judge(id, Verdict.FAILURE, Truth.FALSE)
    for number in range(FINISHED_KEPT):
        run.write(Side.AGENT, run.submit(f"later{number}"), "cancel")
    run.end("failure")
    run.workspace.evidence_of(id).mkdir(parents=True)
    ledger, _ = checkpoint.read_ledger(run.pens[Side.RUNTIME].folder)
    assert id not in ledger.sessions

    seal_rest(run.workspace, ledger)

    assert check_bundle(run.workspace.evidence_of(id)) == []
