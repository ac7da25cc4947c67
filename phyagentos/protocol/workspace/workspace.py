"""A workspace: the folder in which the two planes meet, with everything a run needs and leaves.

It holds copies of the trees, skills, scenes and robots it was created with, so that a run can be repeated from its own
workspace.
"""

import hashlib
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.registries import render_skill_registry, render_target_registry
from phyagentos.protocol.documents.enclosure import check_enclosed
from phyagentos.protocol.documents.markdown import publish
from phyagentos.protocol.sessions.estop import provide_reserve
from phyagentos.protocol.sessions.session import GoalId, SessionId

MARKER = "workspace.yaml"
_TARGETS = "\ntargets:\n"  # in safety.yaml, before the limits of each
_LOCK = ".create.lock"
_LIBRARY_FOLDERS = ("trees", "skills", "predicates", "scenes", "robots")
_COPIED_WHOLE = frozenset({"skills", "robots"})  # a folder is a whole: never a mixture of two roots
_LITTER = ("__pycache__", ".*")


class _Place:
    """A path of a workspace, relative to its root."""

    def __init__(self, relative: str) -> None:
        self._relative = relative

    def __get__(self, workspace: "Workspace", owner: type) -> Path:
        return workspace.root / self._relative


@dataclass(frozen=True, slots=True)
class Workspace:
    """Paths of one workspace; make one with `create` or `open`."""

    root: Path

    library_root = _Place("library")  # copies of trees/, skills/, predicates/, scenes/, robots/
    sessions = _Place("sessions")  # the journal, one folder a partition
    goals = _Place("goals")  # goal graphs as submitted, `<goal id>.yaml`
    evidence = _Place("evidence")  # bundles, one folder a session
    memory = _Place("memory")  # records of memory, one folder a partition
    memory_place = _Place("memory.yaml")  # which memory it began with, and goes on with
    recalled = _Place("recalled")  # copies of what memory said, `<session>.json`
    signals = _Place("signals/new")  # stop requests; those taken stand beside it (see `stop_signals`)
    inbox = _Place("inbox")  # requests of writers without this library, `new/` and `tmp/` (see `edits.inbox`)
    proposals = _Place("proposals")  # goals that a person or a policy decides on (see `agent.tools.proposals`)
    loops = _Place("loops")  # turns and answers of agent-directed sessions, one folder each (see `agent_calls`)
    leases = _Place(".world/leases")  # of sessions that a fleet placed here (see `lease_files`)
    heartbeats = _Place("heartbeats")  # `<target>.json`
    logs = _Place("logs")  # output of the processes, and what each target received
    cache = _Place(".cache")  # may be deleted at any time
    edits = _Place(".edits")  # versions of shared documents that a rendering replaced, until they are taken in
    sessions_document = _Place("SESSIONS.md")
    rejected_document = _Place("SESSIONS.rejected.md")  # edits of SESSIONS.md that were not taken
    task = _Place("TASK.md")
    log = _Place("LOG.md")
    skill_registry = _Place("SKILLRUNTIME.md")
    target_registry = _Place("TARGETS.md")
    environment = _Place("ENVIRONMENT.md")
    lessons = _Place("LESSONS.md")
    knowledge = _Place("KNOWLEDGE.md")
    runtime_signal = _Place("RUNTIME_SIGNAL.md")
    safety = _Place("safety.yaml")
    sensors = _Place("sensors.yaml")
    perception = _Place("perception.yaml")
    runtime_contract = _Place("runtime_contract.yaml")

    @classmethod
    def create(cls, root: Path, library: Library) -> "Workspace":
        """Make a workspace from a library, or complete the one that stands there; what it already holds stays.

        Raises:
            DefinitionError: `NOT_A_WORKSPACE` when the folder holds something else; `LEADS_OUT` as of `open`; every
                problem of a SKILL.md or target.yaml.
        """
        root = root.resolve()
        if root.exists() and not root.is_dir():
            raise _not_a_workspace(root, "a file")
        root.mkdir(parents=True, exist_ok=True)
        is_ours = (root / MARKER).is_file() or (root / _LOCK).is_file()  # the latter: an interrupted `create`
        if not is_ours and (names := sorted(path.name for path in root.iterdir())):
            raise _not_a_workspace(root, ", ".join(names[:5]))
        check_enclosed(root)
        workspace = cls(root)
        with FileLock(root / _LOCK):
            workspace._complete(library)
        return workspace

    @classmethod
    def open(cls, root: Path, *parts: str) -> "Workspace":
        """An existing workspace in which nothing leads out of it, looked at in these `parts` only, if any are named.

        A stop names those it uses: nothing that was dropped elsewhere may hold it up.

        Raises:
            DefinitionError: `NOT_A_WORKSPACE`; `LEADS_OUT` with every link, pipe and device.
        """
        root = root.resolve()
        if not (root / MARKER).is_file():
            found = "no such folder" if not root.exists() else f"no {MARKER}"
            raise _not_a_workspace(root, found)
        check_enclosed(root, *parts)
        return cls(root)

    def evidence_of(self, session: SessionId) -> Path:
        """The evidence bundle of one session."""
        return self.evidence / session

    def answers_of(self, goal: GoalId) -> Path:
        """Where answers of people to questions of one goal are kept; those about a session are in its bundle."""
        return self.goals / goal

    def goal_file_of(self, goal: GoalId) -> Path:
        """The goal graph as it was submitted."""
        return self.goals / f"{goal}.yaml"

    def amended_file_of(self, goal: GoalId, content: bytes) -> Path:
        """Another graph of a goal, named by its content."""
        return self.goals / f"{goal}.{hashlib.sha256(content).hexdigest()[:12]}.yaml"

    def library(self) -> Library:
        """The copies this workspace was created with, and nothing else."""
        return Library((self.library_root,))

    def _complete(self, library: Library) -> None:
        for folder in (
            self.sessions,
            self.goals,
            self.evidence,
            self.signals,
            self.inbox / "tmp",
            self.inbox / "new",
            self.heartbeats,
            self.logs,
            self.cache,
        ):
            folder.mkdir(parents=True, exist_ok=True)
        provide_reserve(self.signals.parent)  # whatever targets there are: a stop must latch on a full disk
        is_new = not (self.root / MARKER).is_file()
        if is_new:
            skills, targets = render_skill_registry(library), render_target_registry(library)  # before any copy
            _copy_library(library, self.library_root)
            publish(self.skill_registry, skills)
            publish(self.target_registry, targets)
        for path in _iter_pristine(library):
            if not (self.root / path.name).exists():
                if path.name == self.safety.name:
                    text = path.read_text(encoding="utf-8")
                    more = _iter_limits(library, text) if _TARGETS in text else ()  # not where all is said in one line
                    publish(self.safety, text + "".join(more))
                else:
                    shutil.copyfile(path, self.root / path.name)
        if not self.skill_registry.exists():
            publish(self.skill_registry, render_skill_registry(self.library()))
        if not self.target_registry.exists():
            publish(self.target_registry, render_target_registry(self.library()))
        if is_new:
            publish(self.root / MARKER, "# This folder is a workspace.\nphy: workspace/1\n")


def _not_a_workspace(root: Path, found: str) -> DefinitionError:
    expected = f"a workspace (a folder with {MARKER}), or an empty folder to make one in"
    return DefinitionError.of("NOT_A_WORKSPACE", str(root), found, expected, "Name another folder with --workspace.")


def _copy_library(library: Library, destination: Path) -> None:
    """Copy every tree, skill, scene and robot; the first root that has one wins."""
    for folder in _LIBRARY_FOLDERS:
        (destination / folder).mkdir(parents=True, exist_ok=True)
        seen: set[Path] = set()
        for root in library.roots:
            source = root / folder
            if not source.is_dir() or source == destination / folder:
                continue
            for path in _iter_units(source, whole=folder in _COPIED_WHOLE):
                copy = destination / folder / path.relative_to(source)
                if copy not in seen:
                    seen.add(copy)
                    copy.parent.mkdir(parents=True, exist_ok=True)
                    _copy_unit(path, copy)


def _copy_unit(source: Path, destination: Path) -> None:
    """Copy a file or a folder so that it appears as a whole."""
    temporary = destination.with_name(f".{destination.name}.tmp")
    if source.is_dir():
        shutil.rmtree(temporary, ignore_errors=True)
        shutil.copytree(source, temporary, ignore=shutil.ignore_patterns(*_LITTER))
        shutil.rmtree(destination, ignore_errors=True)  # of an interrupted `create`
    else:
        shutil.copyfile(source, temporary)
    temporary.replace(destination)


def _iter_units(folder: Path, *, whole: bool) -> Iterator[Path]:
    """What is copied as one: direct children, or every file below."""
    for path in sorted(folder.iterdir() if whole else folder.rglob("*")):
        parts = path.relative_to(folder).parts
        if any(part.startswith(".") or part == "__pycache__" for part in parts):
            continue
        if whole or path.is_file():
            yield path


def _iter_limits(library: Library, known: str) -> Iterator[str]:
    """What the `safety.yaml` beside a profile says below `targets:`, of targets that the known text lacks."""
    for name in library.names_of_targets():
        path = library.get_target(name).with_name("safety.yaml")
        if path.is_file() and f"\n  {name}:" not in known:
            yield "\n" + path.read_text(encoding="utf-8").partition(_TARGETS)[2]


def _iter_pristine(library: Library) -> Iterator[Path]:
    """Documents and settings of the library's protocol/ folders; the first root that has one wins."""
    seen = {"README.md"}
    for root in library.roots:
        for path in sorted((root / "protocol").glob("*")):
            if path.suffix in {".md", ".yaml"} and path.is_file() and path.name not in seen:
                seen.add(path.name)
                yield path
