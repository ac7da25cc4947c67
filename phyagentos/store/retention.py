"""How long evidence is kept: bundles of succeeded sessions are thinned, all others stay whole.

What is removed is first written into the manifest, durably, and only then deleted: no bundle lacks a file silently.
Sessions and goals that have not ended are never touched. The policy stands in runtime_contract.yaml.
"""

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import msgspec
from filelock import FileLock, Timeout

from phyagentos.clock import Clock, compute_seconds
from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions import evidence, evidence_manifest
from phyagentos.protocol.sessions.lifecycle import FINAL_STATES, SessionState
from phyagentos.protocol.sessions.looks import PREFIX
from phyagentos.protocol.sessions.recording import RECORDING
from phyagentos.protocol.sessions.session import SessionId, SessionStatus
from phyagentos.protocol.settings.runtime_contract import EvidenceRetention, read_runtime_contract
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.history import fold_partition
from phyagentos.store.journal import choose_partition

_Bundle = TypeVar("_Bundle")
GRACE_S = 60.0  # a worker may still be sealing the bundle of a session that was judged at once
_DAY_S = 86_400.0
_LOCK = ".retention.lock"
_KINDS = {
    evidence.SCENE_MODEL: "model",
    evidence.SCENE_XML: "model",
    evidence.TRACE: "trace",
    evidence.TRAJECTORY: "trajectory",
    evidence.MOTION: "trajectory",
    RECORDING: "recording",
    evidence.PICTURE_BEFORE: "pictures",
    evidence.PICTURE_AFTER: "pictures",
}
LOOK_KIND = "looks"
_EVERY_KIND = frozenset((*_KINDS.values(), LOOK_KIND))


@dataclass(frozen=True, slots=True, kw_only=True)
class Thinned:
    """One bundle that was thinned, or would be: which files, and by which rule."""

    session: str
    rule: str
    files: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class RetentionReport:
    """What a clean-up did, or would do.

    Attributes:
        sealed_late: Sessions whose bundles had no manifest and got one.
        bytes_before: What all evidence took, shared files counted once.
        bytes_over: How much remains above `max_bytes` and must not be removed.
        damaged: Sessions whose bundles do not match their manifests; nothing is removed from them.
    """

    thinned: tuple[Thinned, ...]
    sealed_late: tuple[str, ...]
    whole: int
    bytes_before: int
    bytes_after: int
    bytes_over: int = 0
    damaged: tuple[str, ...] = ()


def read_retention(workspace: Workspace) -> EvidenceRetention:
    """The policy of a workspace; raises DefinitionError with every problem of runtime_contract.yaml."""
    return read_runtime_contract(workspace.runtime_contract).evidence


def apply_retention(
    workspace: Workspace,
    policy: EvidenceRetention,
    clock: Clock,
    *,
    dry_run: bool = False,
    goes_on: Callable[[], bool] = lambda: True,
) -> RetentionReport:
    """Thin what the policy allows, finish an interrupted clean-up, and drop large files that no bundle needs.

    `goes_on` is called before each bundle is read, measured, chosen or thinned; once it is False the clean-up ends.
    Raises ExecutionError: `BUSY` while another clean-up runs; `WRITE_FAILED`, after which every bundle
    still names its files and the next clean-up goes on.
    """
    if dry_run:
        return _Cleaning(workspace, policy, clock, goes_on).run(dry_run=True)
    try:
        with FileLock(workspace.evidence / _LOCK, timeout=0):
            return _Cleaning(workspace, policy, clock, goes_on).run(dry_run=False)
    except Timeout as error:
        raise ExecutionError("BUSY", f"another clean-up of {workspace.evidence} is under way") from error
    except OSError as error:
        raise ExecutionError("WRITE_FAILED", f"{error}; run it again when that is mended") from error


def find_kind(name: str) -> str | None:
    """What a file of a bundle is for the policy; None for what always stays."""
    return LOOK_KIND if name.startswith((PREFIX, evidence.POLICY_PREFIX)) else _KINDS.get(name)


@dataclass(slots=True)
class _Space:
    """What the evidence takes, each inode counted once however many bundles share it."""

    sizes: dict[tuple[int, int], int] = field(default_factory=dict)
    needed_by: dict[tuple[int, int], set[Path]] = field(default_factory=dict)
    total: int = 0

    def add(self, path: Path, *, is_object: bool = False) -> None:
        status = path.stat()
        inode = (status.st_dev, status.st_ino)
        if inode not in self.sizes:
            self.sizes[inode] = status.st_size
            self.total += status.st_size
        if not is_object:
            self.needed_by.setdefault(inode, set()).add(path)

    def remove(self, path: Path) -> None:
        """Account for a file that goes; the space is free when no other bundle needs it."""
        status = path.stat()
        needed = self.needed_by.get((status.st_dev, status.st_ino), set())
        needed.discard(path)
        if not needed:
            self.total -= self.sizes.pop((status.st_dev, status.st_ino), 0)


class _Cleaning:
    """One clean-up."""

    def __init__(
        self, workspace: Workspace, policy: EvidenceRetention, clock: Clock, goes_on: Callable[[], bool]
    ) -> None:
        self._workspace, self._policy, self._goes_on = workspace, policy, goes_on
        self._now = clock.wall_iso()
        self._space = _Space()
        self._manifests: dict[str, evidence_manifest.Manifest | None] = {}  # of bundles whose sessions have ended
        self._damaged: dict[str, None] = {}
        self._chosen: dict[str, tuple[str, dict[str, None]]] = {}  # session -> rule, files

    def run(self, *, dry_run: bool) -> RetentionReport:
        folders = {path.name: path for path in evidence_manifest.iter_bundles(self._workspace.evidence)}
        ended = {id: status for id, status in _find_ended(self._workspace, self._now).items() if id in folders}
        for id in self._each(ended):
            try:
                self._manifests[id] = evidence_manifest.read_manifest(folders[id])
            except ExecutionError:
                self._damaged[id] = None
        unsealed = tuple(sorted(name for name, manifest in self._manifests.items() if manifest is None))
        if not dry_run:
            sealer = evidence_manifest.Sealer(self._workspace.evidence)
            self._manifests |= {name: sealer.seal(folders[name], late=True) for name in unsealed}
            self._finish_interrupted(folders)
        self._measure(folders.values())
        before = self._space.total
        by_age = sorted(ended.values(), key=lambda status: (status.updated_at, status.contract.id))
        self._choose([each for each in by_age if each.state == SessionState.SUCCEEDED], folders)
        if not dry_run:
            for name, (rule, files) in self._each(self._chosen.items()):
                self._thin(folders[name], ended[SessionId(name)], rule, files)
            _sweep(self._workspace.evidence)
        touched = {name for name, manifest in self._manifests.items() if manifest is not None and manifest.thinned}
        over = max(0, self._space.total - self._policy.max_bytes) if self._policy.max_bytes is not None else 0
        return RetentionReport(
            thinned=tuple(Thinned(session=name, rule=rule, files=tuple(f)) for name, (rule, f) in self._chosen.items()),
            sealed_late=unsealed,
            whole=len(folders.keys() - touched - self._chosen.keys()),
            bytes_before=before,
            bytes_after=self._space.total,
            bytes_over=over,
            damaged=tuple(self._damaged),
        )

    def _each(self, bundles: Iterable[_Bundle]) -> Iterator[_Bundle]:
        return itertools.takewhile(lambda _: self._goes_on(), bundles)

    def _choose(self, succeeded: list[SessionStatus], folders: Mapping[str, Path]) -> None:
        """Decide what goes: first what is not to be kept, then from the oldest on until the rest fits."""
        policy = self._policy
        beyond = max(len(succeeded) - policy.keep_last, 0)
        for status in self._each(succeeded[:beyond]):
            if compute_seconds(status.updated_at, self._now) > policy.keep_days * _DAY_S:
                rule = f"keep_last {policy.keep_last}, keep_days {policy.keep_days:g}"
                self._take(folders[status.contract.id], rule, frozenset(policy.drop))
        if policy.max_bytes is None:
            return
        for kinds in (frozenset(policy.drop), _EVERY_KIND):
            for status in self._each(succeeded):
                if self._space.total <= policy.max_bytes:
                    return
                self._take(folders[status.contract.id], f"max_bytes {policy.max_bytes}", kinds)

    def _take(self, folder: Path, rule: str, kinds: frozenset[str]) -> None:
        manifest = self._manifests.get(folder.name)
        rule, names = self._chosen.get(folder.name, (rule, {}))
        more = [name for name in manifest.files if find_kind(name) in kinds and name not in names] if manifest else []
        if not more or folder.name in self._damaged:
            return
        if evidence_manifest.check_bundle(folder):  # what is damaged is left for a person to see
            self._damaged[folder.name] = None
            return
        for name in more:
            self._space.remove(folder / name)
        self._chosen[folder.name] = (rule, names | dict.fromkeys(more))

    def _thin(self, folder: Path, status: SessionStatus, rule: str, names: Iterable[str]) -> None:
        """Mark in the manifest what goes, wait for the disk, then delete it."""
        manifest = self._manifests[folder.name]
        if manifest is None:
            return
        gone = {name: manifest.files[name] for name in names}
        thinning = evidence_manifest.Thinning(
            at=self._now, rule=rule, policy=self._policy.model_dump(mode="json"), files=gone
        )
        thinned = msgspec.structs.replace(
            manifest,
            files={name: record for name, record in manifest.files.items() if name not in gone},
            thinned=(*manifest.thinned, thinning),
            outcome=evidence_manifest.Outcome(state=status.state, at=status.updated_at, attempts=status.attempts),
        )
        evidence_manifest.replace_manifest(folder, thinned)
        _delete_gone(folder, thinned)

    def _finish_interrupted(self, folders: Mapping[str, Path]) -> None:
        for name, manifest in self._manifests.items():
            if manifest is not None:
                _delete_gone(folders[name], manifest)
            for path in folders[name].glob(".*.tmp"):
                path.unlink()

    def _measure(self, folders: Iterable[Path]) -> None:
        for folder in self._each(folders):
            for path in folder.rglob("*"):
                self._space.add(path)
        for path in evidence_manifest.iter_objects(self._workspace.evidence):
            if path.stat().st_nlink > 1:  # the others are swept
                self._space.add(path, is_object=True)


def _find_ended(workspace: Workspace, now: str) -> dict[SessionId, SessionStatus]:
    """Sessions that are final, for more than a moment, and whose goal has ended too."""
    ledger = fold_partition(workspace.sessions / choose_partition(workspace.sessions))
    running = {id for id, goal in ledger.goals.items() if not goal.verdict and not goal.is_cancelled}
    return {
        id: status
        for id, status in ledger.sessions.items()
        if status.state in FINAL_STATES
        and status.contract.goal not in running
        and compute_seconds(status.updated_at, now) > GRACE_S
    }


def _delete_gone(folder: Path, manifest: evidence_manifest.Manifest) -> None:
    for name in manifest.gone:
        if name not in manifest.files:
            (folder / name).unlink(missing_ok=True)


def _sweep(evidence_folder: Path) -> None:
    """Delete large files that no bundle links to any more; one that is linked meanwhile lives on in its bundle."""
    for path in evidence_manifest.iter_objects(evidence_folder):
        if path.stat().st_nlink == 1:
            path.unlink()
