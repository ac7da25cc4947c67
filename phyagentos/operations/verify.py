"""Other judgements: of a session that has its verdict, of its camera frames perceived again, and of goalless sessions.

The frames are perceived without a simulator and without ground truth: the only model loaded is the robot's own, to mask
it in pictures.
"""

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import msgspec

from phyagentos.agent.judging.goal_judgement import Evidence
from phyagentos.agent.judging.review import JudgedAgain, judge_again, judge_goalless_sessions, review_session
from phyagentos.assembly.verification import build_verifier
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError, ExecutionError, Problem
from phyagentos.operations.workspaces import find_session, read_ledger
from phyagentos.protocol.capabilities.registries import get_registered_target
from phyagentos.protocol.documents.schema import read_yaml
from phyagentos.protocol.sessions import evidence
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.looks import LOOKS, LookEntry, read_looks
from phyagentos.protocol.sessions.session import SessionId, SessionStatus
from phyagentos.protocol.sessions.verdicts import Attempt
from phyagentos.protocol.settings.settings_files import compute_file_hash
from phyagentos.protocol.settings.verification_mode import VerificationMode
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import Environment
from phyagentos.store.journal import Journal
from phyagentos.store.subjects import get_session


class Judged(msgspec.Struct, frozen=True, kw_only=True):
    """A judgement that was recorded; of a session that has its verdict, which stays, it is the `number`th."""

    session: SessionId
    judgement: Attempt
    number: int = 1
    verdict: str = ""


def verify(
    root: Path,
    name: str,
    *,
    judges: Sequence[str] | None = None,
    mode: VerificationMode = VerificationMode.ENFORCE,
    by: str = "paos verify",
) -> Judged:
    """Add a judgement to a session that has its verdict; erases none and changes no state.

    `judges` are those of the settings without. Raises DefinitionError `UNKNOWN_NAME`, `NOT_EXECUTED`.
    """
    place, clock = Workspace.open(root), SystemClock()
    verifier = build_verifier(place, clock, mode=mode, judges=judges)
    sessions = read_ledger(root, name).sessions
    status = sessions[get_session(name, sessions)]
    with closing(Journal(place.root, side=Side.AGENT, by=by, clock=clock)) as journal:
        own, others = status.contract, sessions.values()
        lineage = [each for each in others if (each.contract.goal, each.contract.node) == (own.goal, own.node)]
        attempt = review_session(place, journal, status, verifier, lineage)
    decided = status.decision.verdict if status.decision is not None else ""
    return Judged(session=own.id, judgement=attempt, number=len(status.attempts) + 1, verdict=decided)


def verify_from_frames(
    root: Path, name: str, *, judges: Sequence[str] | None = None, mode: VerificationMode = VerificationMode.ENFORCE
) -> JudgedAgain:
    """Perceive the stored camera frames of a session again, judge, and compare with the record; records nothing."""
    place, status = find_session(root, name)
    verifier = build_verifier(place, SystemClock(), mode=mode, judges=judges)
    return judge_again(Evidence(root).read(status), perceive_again(place, status), verifier, status.decision)


def judge(root: Path, *, by: str = "paos judge") -> tuple[Judged, ...]:
    """Judge the executed sessions without a goal, which no agent looks at."""
    place, clock = Workspace.open(root), SystemClock()
    verifier = build_verifier(place, clock)
    with closing(Journal(place.root, side=Side.AGENT, by=by, clock=clock)) as journal:
        judged = judge_goalless_sessions(place, journal, verifier)
    return tuple(Judged(session=id, judgement=attempt, verdict=attempt.verdict) for id, attempt in judged)


def perceive_again(workspace: Workspace, status: SessionStatus) -> list[tuple[LookEntry, Environment]]:
    """Each look that a session's bundle names, and the world as perception makes it of that look now.

    Raises:
        ExecutionError: `EVIDENCE_DAMAGED`, which name the file; `CHANGED` where perception
            now reads something else than it did.
        DefinitionError: `CHANGED` where the settings are not those of the session.
    """
    execution, target = status.execution, status.contract.target
    folder = workspace.root / execution.evidence if execution is not None else workspace.evidence / status.contract.id
    entries = read_looks(folder)
    if not entries:
        found = "its sensing was truth, its target has no camera, or an earlier version recorded it"
        raise ExecutionError("EVIDENCE_DAMAGED", f"{folder / LOOKS}: no look was recorded; {found}")
    recorded = read_yaml(folder / evidence.CONTRACT).data.get("settings_sha256", {})
    found = "another file than the session ran with"
    hint = f"Restore it, or judge on the snapshots: `paos verify {folder.name}` without --from-frames."
    changed = [
        Problem("CHANGED", str(path), found, f"sha256 {recorded[path.name]}", hint)
        for path in (workspace.perception, workspace.sensors)
        if path.name in recorded and compute_file_hash(path) != recorded[path.name]
    ]
    if changed:
        raise DefinitionError(changed)
    from phyagentos.assembly.worker_process import open_world_model
    from phyagentos.runtime.perception.look import RecordedFrames
    from phyagentos.runtime.perception.look_file import read_look
    from phyagentos.runtime.perception.perceived_world import PerceivedWorld
    from phyagentos.runtime.preflight.settings import read_settings

    looks = {entry.file: read_look(folder / entry.file, entry.sha256) for entry in entries}
    profile = get_registered_target(workspace.target_registry, target)
    eyes = RecordedFrames(next(iter(looks.values())))
    world = open_world_model(workspace, target, profile, eyes, read_settings(workspace, target))
    if not isinstance(world, PerceivedWorld):
        raise ExecutionError("CHANGED", f"{workspace.perception}: sensing is truth, the session's was perceived")
    worlds = {file: world.repeat(look) for file, look in looks.items()}
    return [(entry, worlds[entry.file]) for entry in entries]
