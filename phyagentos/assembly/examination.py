"""Sessions checked by the real processes of their targets, in a temporary workspace: what `paos preflight` does."""

import shutil
from collections.abc import Sequence

import msgspec

from phyagentos.assembly.paths import TOKENS
from phyagentos.assembly.runtime_plane import open_worker
from phyagentos.errors import ExecutionError, Problem, relocate
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.registries import read_target_registry
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.settings.settings_files import SETTINGS_FILES
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.worker.orders import Check, Checked
from phyagentos.scratch import open_scratch

DOCUMENTS = ("SKILLRUNTIME.md", "TARGETS.md", *SETTINGS_FILES)
LOG_TAIL = 400  # characters of a worker's log that go into a message


def examine(library: Library, source: Workspace | None, sessions: Sequence[Session]) -> dict[str, Checked]:
    """Check sessions with a dry run, each in the world as its scene begins, commanding nothing; findings by session.

    Documents, settings and keys are those of `source`, which is only read, else those that ship. Raises ExecutionError
    `RUNNER_LOST` when a worker ends instead of answering.
    """
    found: dict[str, Checked] = {}
    with open_scratch() as folder:
        workspace = Workspace.create(folder / "workspace", library)
        if source is not None:
            for name in DOCUMENTS:
                shutil.copyfile(source.root / name, workspace.root / name)
            if (keys := source.root / TOKENS).is_dir():  # of targets that are served elsewhere
                shutil.copytree(keys, workspace.root / TOKENS, dirs_exist_ok=True)
        known = read_target_registry(workspace.target_registry)
        for target in dict.fromkeys(session.target for session in sessions):
            wanted = [session for session in sessions if session.target == target]
            if target in known:
                found |= _examine_on(workspace, target, wanted)
                continue
            for each in wanted:
                problem = Problem.unknown("target", f"{each.id}: target", target, known, by="the session")
                found[each.id] = Checked(session=each.id, plan=None, tools=None, problems=(problem,))
    return found


def _examine_on(workspace: Workspace, target: str, sessions: Sequence[Session]) -> dict[str, Checked]:
    found: dict[str, Checked] = {}
    with open_worker(workspace, target) as worker:
        for session in sessions:
            worker.send(Check(session=session, epoch=1, thorough=True))
            answer = worker.receive()
            if not isinstance(answer, Checked):
                log = workspace.logs / f"worker-{target}.log"
                end = (
                    log.read_text(encoding="utf-8", errors="replace").strip()[-LOG_TAIL:]
                    if log.exists()
                    else "it left no log"
                )
                raise ExecutionError("RUNNER_LOST", f"the worker of {target!r} ended: {end}")
            found[session.id] = msgspec.structs.replace(answer, problems=relocate(answer.problems, workspace.root))
    return found
