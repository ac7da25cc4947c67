"""Skills that memory has learned: tried on known starts, then written into a project; and taken out again."""

import shutil
from collections.abc import Mapping
from pathlib import Path

import msgspec

from phyagentos.agent.memory.sequences import Composition, Start, compose, find_starts
from phyagentos.assembly.agent_plane import MemoryUse, open_agent
from phyagentos.assembly.planes import start_watch
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.operations.lint import lint_file
from phyagentos.operations.recall import find_entry, open_memory
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.registries import read_skill_registry
from phyagentos.protocol.capabilities.skill_runtimes import read_skill
from phyagentos.protocol.settings.settings_files import SETTINGS_FILES
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.scratch import open_scratch


class Promoted(msgspec.Struct, frozen=True, kw_only=True):
    """A skill that was made of a lesson: the known starts that it succeeded on, and the files that were written."""

    skill: str
    entry: str
    trials: int
    files: tuple[Path, ...]


class Revoked(msgspec.Struct, frozen=True, kw_only=True):
    """A promoted skill that was taken out of a project, and the entry that it was made of, which stays."""

    skill: str
    entry: str


def promote(root: Path, entry: str, project: Path, name: str, *, trials: int = 3) -> Promoted:
    """Write the skill that a lesson of a workspace has proved into a project, once it has passed its regression test.

    The test is the skill on the latest `trials` starts on which the sequence was verified, with the settings of the
    workspace, each judged as any session. Nothing is written where one fails.

    Raises:
        DefinitionError: `UNKNOWN_NAME`; `NOT_PERMITTED`; `WOULD_OVERWRITE`; every problem of the files.
    """
    memory = open_memory(root)
    find_entry(memory, entry, root)
    lesson, workspace = memory.experience.corrections.get(entry), Workspace.open(root)
    if lesson is None:
        raise DefinitionError.of("NOT_PERMITTED", str(root), entry, "a lesson about what has to come first")
    starts = find_starts(lesson, memory.read_all())[-trials:]
    skills = read_skill_registry(workspace.skill_registry)
    composed = compose(name, lesson, skills, starts, memory=memory.snapshot)
    if len(starts) < trials:
        expected = f"{trials} starts on which the whole sequence was verified"
        raise DefinitionError.of("NOT_PERMITTED", entry, f"{len(starts)} of them", expected)
    texts = {Path("trees", f"{name}.yaml"): composed.render_tree()}
    texts[Path("skills", name, "SKILL.md")] = composed.render_skill()
    if there := [project / path for path in texts if (project / path).exists()]:
        raise DefinitionError.of("WOULD_OVERWRITE", str(there[0]), "a file", "a name that is free", "Choose another.")
    with open_scratch() as folder:
        _write(folder, texts)
        if problems := [problem for path in texts for problem in lint_file(folder / path)]:
            raise DefinitionError(problems)
        for start in starts:
            _try(composed, start, workspace, folder)
    return Promoted(skill=name, entry=entry, trials=trials, files=_write(project, texts))


def revoke(project: Path, name: str) -> Revoked:
    """Take a learned skill and its tree out of a project; raises `NOT_PERMITTED` for one that people wrote."""
    path = Library((project,)).get_skill(name)
    skill, _ = read_skill(path)
    if skill.learned is None:
        raise DefinitionError.of(
            "NOT_PERMITTED", str(path), "a skill that was written by hand", "one that was promoted"
        )
    shutil.rmtree(path.parent)
    (project / "trees" / f"{skill.tree}.yaml").unlink(missing_ok=True)
    return Revoked(skill=name, entry=skill.learned.entry)


def _write(root: Path, texts: Mapping[Path, str]) -> tuple[Path, ...]:
    for path, text in texts.items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text(text, encoding="utf-8")
    return tuple(root / path for path in texts)


def _try(composed: Composition, start: Start, workspace: Workspace, folder: Path) -> None:
    """Raises `NOT_PERMITTED` unless the skill succeeds on this start."""
    seed, clock = start[-1].seed, SystemClock()
    goal = Path("goal_graphs", "try.yaml")
    _write(folder, {goal: composed.render_goal(start)})
    trial = Workspace.create(folder / f"trial-{seed}", Library.open(folder, *workspace.library().roots))
    for name in SETTINGS_FILES:
        shutil.copyfile(workspace.root / name, trial.root / name)
    with (
        start_watch(trial, pictures=False).running(clock) as plane,
        open_agent(trial, clock, memory_use=MemoryUse.NONE, is_runtime_alive=plane.is_alive) as agent,
    ):
        report = agent.mission.run(folder / goal, seed=seed)
    if report.verdict != "success":
        found = f"{report.verdict} on seed {seed}: {report.reason}"
        raise DefinitionError.of("NOT_PERMITTED", composed.skill.skill, found, "success on every start that is known")
