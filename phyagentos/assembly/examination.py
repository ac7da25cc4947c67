"""Sessions checked by the real processes of their targets, in a temporary workspace: what `paos preflight` does."""

import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import msgspec

from phyagentos.assembly.runtime_plane import hire_worker, start_world
from phyagentos.errors import ExecutionError, Problem, format_names
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.registries import read_target_registry
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.settings.settings_files import SETTINGS_FILES
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.worker.orders import Check, Checked

DOCUMENTS = ("SKILLRUNTIME.md", "TARGETS.md", *SETTINGS_FILES)
LOG_TAIL = 400  # characters of a worker's log that go into a message


@dataclass(frozen=True, slots=True)
class Examination:
    """A workspace that is thrown away, in which sessions are examined and nothing is commanded."""

    workspace: Workspace

    @classmethod
    @contextmanager
    def open(cls, library: Library, source: Workspace | None = None) -> Iterator["Examination"]:
        """A fresh workspace with the documents and settings of `source` (only read), else with those that ship."""
        with tempfile.TemporaryDirectory(prefix="paos-") as folder:
            workspace = Workspace.create(Path(folder) / "workspace", library)
            if source is not None:
                for name in DOCUMENTS:
                    shutil.copyfile(source.root / name, workspace.root / name)
            yield cls(workspace)

    def examine(self, sessions: Sequence[Session]) -> Mapping[str, Checked]:
        """Check sessions with a dry run, each in the world as its scene begins; findings by session.

        Raises:
            ExecutionError: `RUNNER_LOST` when a worker ends instead of answering.
        """
        found: dict[str, Checked] = {}
        known = read_target_registry(self.workspace.target_registry)
        for target in dict.fromkeys(session.target for session in sessions):
            wanted = [session for session in sessions if session.target == target]
            if target not in known:
                found |= {session.id: _refuse(session, known) for session in wanted}
            else:
                found |= self._examine_on(target, wanted)
        return {session.id: found[session.id] for session in sessions}

    def _examine_on(self, target: str, sessions: Sequence[Session]) -> Iterator[tuple[str, Checked]]:
        found = []
        with tempfile.TemporaryDirectory(prefix="paos-") as sockets:
            world = start_world(self.workspace, target, Path(sockets))
            worker = hire_worker(self.workspace, target, Path(sockets), pictures=False, world=world)
            try:
                answer = worker.receive()  # ready
                for session in sessions:
                    worker.send(Check(session=session, epoch=1, thorough=True))
                    answer = worker.receive()
                    if not isinstance(answer, Checked):
                        raise ExecutionError("RUNNER_LOST", f"the worker of {target!r} ended: {self._read_log(target)}")
                    found.append((str(session.id), self._relocate(answer)))
            finally:
                worker.stop()
        return iter(found)

    def _relocate(self, answer: Checked) -> Checked:
        """Addresses without the folder that will be gone."""
        folder = f"{self.workspace.root}/"
        problems = tuple(
            msgspec.structs.replace(each, address=each.address.replace(folder, "")) for each in answer.problems
        )
        return msgspec.structs.replace(answer, problems=problems)

    def _read_log(self, target: str) -> str:
        log = self.workspace.logs / f"worker-{target}.log"
        return log.read_text(errors="replace").strip()[-LOG_TAIL:] if log.exists() else "it left no log"


def _refuse(session: Session, known: Mapping[str, object]) -> Checked:
    problem = Problem(
        "TARGET_UNKNOWN", f"{session.id}: target", repr(session.target), format_names(known), triggered_by="the session"
    )
    return Checked(session=session.id, plan=None, tools=None, problems=(problem,))
