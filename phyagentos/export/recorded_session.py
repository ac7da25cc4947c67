"""One session as it was recorded: its contract, its records in the journal, its bundle. Read by the writers of logs."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.registries import get_registered_target
from phyagentos.protocol.sessions.evidence import TRAJECTORY, Bundle, read_bundle
from phyagentos.protocol.sessions.evidence_manifest import check_bundle
from phyagentos.protocol.sessions.session import SessionId, SessionStatus
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.history import Histories, fold
from phyagentos.store.journal import choose_partition
from phyagentos.store.records import Record


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedSession:
    """A session that left evidence.

    Attributes:
        records: Of the journal, the oldest first.
        joints: Names of the columns of the trajectory.
        trajectory: Arrays of `trajectory.npz` by name; empty where a clean-up took it out.
    """

    status: SessionStatus
    bundle: Bundle
    records: tuple[Record, ...]
    joints: tuple[str, ...]
    trajectory: Mapping[str, NDArray[Any]]


def read_recorded_session(workspace: Workspace, id: SessionId) -> RecordedSession:
    """A session of a workspace.

    Raises:
        DefinitionError: `NOTHING_TO_EXPORT` where it left no evidence; what `check_bundle` finds of a bundle that is
            not as it was recorded.
        ExecutionError: `EVIDENCE_UNREADABLE`, `JOURNAL_DAMAGED`.
    """
    with Histories(workspace.sessions / choose_partition(workspace.sessions)) as histories:
        records = tuple(histories.find(id))
    status, folder = fold(records).sessions[id], workspace.evidence_of(id)
    if status.execution is None or not folder.is_dir():
        raise DefinitionError.of("NOTHING_TO_EXPORT", id, f"{status.state}, without evidence", "a session that ran")
    if problems := check_bundle(folder):
        raise DefinitionError(problems)
    return RecordedSession(
        status=status,
        bundle=read_bundle(folder, status.contract, status.execution),
        records=records,
        joints=get_registered_target(workspace.target_registry, status.contract.target).arm.joints,
        trajectory=_read_arrays(folder / TRAJECTORY),
    )


def _read_arrays(path: Path) -> Mapping[str, NDArray[Any]]:
    if not path.is_file():
        return {}
    with np.load(path) as recorded:
        return dict(recorded)
