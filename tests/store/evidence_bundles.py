"""A workspace with evidence bundles, written as recorder, worker and both planes would."""

from pathlib import Path

from phyagentos.protocol.sessions import evidence
from phyagentos.protocol.sessions.evidence_manifest import (
    Sealer,
    check_bundle,
    check_objects,
    iter_bundles,
)
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.sessions.verdicts import Attempt, Criterion, Verdict
from phyagentos.protocol.settings.runtime_contract import EvidenceRetention
from phyagentos.protocol.world.truth import Truth
from phyagentos.store.retention import apply_retention
from phyagentos.testing import ManualClock
from tests.pens import Pens

MODEL = b"model" * 40_000
DAY_S = 86_400.0
EVERYTHING = EvidenceRetention(keep_last=0, keep_days=0)
SMALL = {
    evidence.CONTRACT: b"session: {}\n",
    evidence.BEFORE: b"{}",
    evidence.AFTER: b"{}",
    evidence.HOLDS: b"[]",
    evidence.EXECUTION: b"{}",
    evidence.INITIAL: b"initial",
    evidence.TERMINAL: b"terminal",
}
HEAVY = {evidence.TRACE, evidence.TRAJECTORY, evidence.PICTURE_BEFORE, evidence.PICTURE_AFTER}


class Store(Pens):
    """A workspace with bundles, written as recorder, worker and both planes would."""

    def __init__(self, root: Path, submit) -> None:
        super().__init__(root, ManualClock(1_700_000_000.0))
        self.submit = submit
        self.sealer = Sealer(self.workspace.evidence)

    def begin(self, id):
        self.commit(Side.AGENT, self.submit(id))
        self.claim(id)
        folder = self.workspace.evidence_of(id)
        folder.mkdir()
        own = {
            evidence.TRACE: f"trace of {id}\n".encode(),
            evidence.TRAJECTORY: id.encode() * 10_000,
            evidence.PICTURE_BEFORE: b"picture" * 20_000,
            evidence.PICTURE_AFTER: id.encode() * 20_000,
            evidence.SCENE_MODEL: MODEL,
            evidence.SCENE_XML: b"<mujoco/>" * 10_000,
        }
        for name, data in (SMALL | own).items():
            (folder / name).write_bytes(data)
        return folder

    def end(self, id, verdict=Verdict.SUCCESS, *, seal=True):
        self.finish(id, ended=Ended.COMPLETED)
        if seal:
            self.sealer.seal(self.workspace.evidence_of(id))
        criterion = Criterion(text="inside(a, b)", kind="accept", truth=Truth.TRUE, measured={"margin_m": 0.05})
        self.decide(id, Attempt(verdict=verdict, criteria=(criterion,)))

    def run(self, id, verdict=Verdict.SUCCESS, *, seal=True):
        folder = self.begin(id)
        self.end(id, verdict, seal=seal)
        self.clock.advance(DAY_S)
        return folder

    def prune(self, policy=EVERYTHING, **options):
        return apply_retention(self.workspace, policy, self.clock, **options)

    def check(self):
        folders = list(iter_bundles(self.workspace.evidence))
        return [problem for folder in folders for problem in check_bundle(folder)] + check_objects(
            self.workspace.evidence
        )


def names_in(folder):
    return {path.name for path in folder.iterdir()}


def read_all(folder):
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}
