"""The evidence bundle of one session: `evidence/<session id>/`. Paper section 4.2.

It is complete without this package: MuJoCo alone loads the scene, numpy the arrays; everything else is JSON or YAML.
"""

import contextlib
import hashlib
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec

from phyagentos.errors import ExecutionError
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.regular_files import read_regular
from phyagentos.protocol.sessions.evidence_manifest import PART_MAX
from phyagentos.protocol.sessions.lessons import Lesson
from phyagentos.protocol.sessions.session import Execution, Session, SessionStatus
from phyagentos.protocol.sessions.trace import TraceEvent
from phyagentos.protocol.sessions.verdicts import Criterion, EvidenceReference
from phyagentos.protocol.world.environment import Environment

CONTRACT = "contract.yaml"  # the session as submitted, adapter plan and hashes of the settings files
SCENE_MODEL = "scene.mjb"  # compiled model, loadable by MuJoCo alone
SCENE_XML = "scene.xml"  # the same, readable
INITIAL = "initial.npz"  # state (mjSTATE_INTEGRATION), time, qpos, qvel, act
TERMINAL = "terminal.npz"
OWN_SNAPSHOTS = {name: name.replace(".npz", ".snapshot") for name in (INITIAL, TERMINAL)}  # what only a driver reads
BEFORE = "environment_before.json"  # Environment
AFTER = "environment_after.json"
TRACE = "trace.jsonl"  # one TraceEvent per change of a node of the tree; grows while the session runs
TRAJECTORY = "trajectory.npz"  # time_s, q_commanded, q_measured, qd_measured, gripper_*_m; force_n where it is felt
MOTION = "motion.npz"  # time_s, qpos (n, nq): the simulated world 25 times a second; never read by the agent
TAKEN_OVER = "taken_over"  # kind of the event from which on a person moves the arm; `by` says who
EVENTS = "events.jsonl"  # safety interventions, planner answers, errors of leaves, timing
HOLDS = "holds.json"  # list of Criterion: worst value of each hold condition and constraint
FAULTS = "faults.json"  # what the simulated world did; never read by the agent
FINGERPRINT = "fingerprint.json"  # versions, CPU; the seeds stand in the contract
EXECUTION = "execution.json"  # Execution
PICTURE_BEFORE = "before.png"
PICTURE_AFTER = "after.png"
POLICY = "policy.jsonl"  # of a policy: one line for each chunk, runtime.policies.exchanges
POLICY_PREFIX = "policy-"  # of the files that these lines name: what was shown and answered


class Event(msgspec.Struct, frozen=True, kw_only=True):
    """Something that happened beside the tree: an intervention of the guard, an answer of the planner, ..."""

    time_s: float
    kind: str
    code: str = ""
    details: Fields = {}


class Bundle(msgspec.Struct, frozen=True, kw_only=True):
    """What the verifier reads of a bundle.

    Attributes:
        before: World before the session, None when it could not be observed.
        holds: Worst sample of each hold condition and constraint.
        references: The files that this was read from.
        prior: Earlier sessions of its node, the oldest first; no file of the bundle, the verifier adds them.
        lessons: Lessons in force for it, likewise.
    """

    folder: Path
    session: Session
    execution: Execution
    before: Environment | None
    after: Environment | None
    holds: tuple[Criterion, ...]
    trace: tuple[TraceEvent, ...]
    events: tuple[Event, ...]
    references: tuple[EvidenceReference, ...] = ()
    prior: tuple[SessionStatus, ...] = ()
    lessons: tuple[Lesson, ...] = ()

    @property
    def interventions(self) -> tuple[Event, ...]:
        """What the guards refused or changed."""
        return tuple(event for event in self.events if event.kind == "intervention")


def read_bundle(folder: Path, session: Session, execution: Execution, *, with_course: bool = True) -> Bundle:
    """Read what a runner left; trace and events, which explain a failure, only `with_course`.

    Raises:
        ExecutionError: `EVIDENCE_DAMAGED` when a file is damaged; a missing or empty one reads as None or empty.
    """
    names = (BEFORE, AFTER, HOLDS, *((TRACE, EVENTS) if with_course else ()))
    try:
        data = {name: found for name in names if (found := _find_bytes(folder / name))}  # an empty one is none
        return Bundle(
            folder=folder,
            session=session,
            execution=execution,
            before=_decode(data.get(BEFORE), Environment),
            after=_decode(data.get(AFTER), Environment),
            holds=_decode(data.get(HOLDS), tuple[Criterion, ...]) or (),
            trace=_decode_lines(data.get(TRACE), TraceEvent),
            events=_decode_lines(data.get(EVENTS), Event),
            references=tuple(refer_to(name, found) for name, found in data.items()),
        )
    except (msgspec.MsgspecError, OSError) as error:
        raise ExecutionError("EVIDENCE_DAMAGED", f"{folder}: {error}") from error


def count_solver_calls(events: Iterable[Event]) -> Counter[str]:
    """How often the planner called each of its libraries (`runtime.motion.calls`) in a session."""
    calls = Counter[str]()
    for event in events:
        calls.update(event.details.get("stages", {}).get("calls", {}))
    return calls


def refer_to(file: str, data: bytes) -> EvidenceReference:
    """The reference of a judgement to a file that it read."""
    return EvidenceReference(file=file, sha256=hashlib.sha256(data).hexdigest())


def encode_json(value: object) -> bytes:
    """Indented JSON."""
    return msgspec.json.format(msgspec.json.encode(value), indent=2) + b"\n"


def write_json(path: Path, value: object) -> None:
    """Write indented JSON."""
    path.write_bytes(encode_json(value))


def encode_lines(values: list[object]) -> bytes:
    """One JSON value a line."""
    return b"".join([msgspec.json.encode(value) + b"\n" for value in values])


def _decode(data: bytes | None, kind: object) -> Any:
    return msgspec.json.decode(data, type=kind) if data else None


def _decode_lines(data: bytes | None, kind: object) -> Any:
    return tuple(msgspec.json.decode(line, type=kind) for line in (data or b"").splitlines())


def _find_bytes(path: Path) -> bytes | None:
    with contextlib.suppress(FileNotFoundError):
        return read_regular(path, PART_MAX)
    return None
