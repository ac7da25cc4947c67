"""SKILLRUNTIME.md and TARGETS.md: what this workspace can run and on what, generated and read back.

One `## name` and one YAML block an entry.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.skill_runtimes import SKILLRUNTIME, SkillRuntime, read_skill
from phyagentos.protocol.capabilities.targets import (
    TARGETS,
    RegisteredTarget,
    TargetHealth,
    TargetProfile,
    read_targets,
)
from phyagentos.protocol.documents.document import DocumentFormat, Front, read_document
from phyagentos.protocol.documents.markdown import format_moment, publish, render_block, render_front, render_table
from phyagentos.protocol.documents.schema import Authored, read_yaml, validate

_BlockT = TypeVar("_BlockT")

_SKILLS_HEAD = """# Skills that this workspace can run

What each skill takes, what must hold before and during, what it guarantees, what it needs of a target, and the
behaviour tree that carries it out.

- **Written by** the registry, once, when the workspace is created, from the front of `library/skills/*/SKILL.md`.
- **An edit stands**, and counts from the next start of agent and runtime on: this document is what both read. It is
  checked then, and by `paos lint`. To change a skill for good, edit its SKILL.md in the project.
- **What memory has promoted** stands in `promoted`, and is renewed at the end of a goal when it changes.
- **No limit is here**: what the guard enforces is in `safety.yaml`.

"""
_TARGETS_HEAD = """# Targets of this workspace

What each target is and can do, and how its worker is.

- **Written by** the registry, once, when the workspace is created, from `library/robots/*/target.yaml`; then by the
  process of the watchdog, which renews `health` when it changes, and nothing else.
- **An edit of a block stands**, and counts from the next start of agent and runtime on: this document is what both
  read. Comments and other words are lost when the health changes. To change a target for good, edit its target.yaml in
  the project.
- **Health** is as the runtime last saw it; whether one is running now is in `RUNTIME_SIGNAL.md`.
- **What a target may do** is not here: the limits that the guard enforces are in `safety.yaml`.

"""
_NOTHING = "The registry has not run yet.\n"


def render_skill_registry(library: Library) -> str:
    """SKILLRUNTIME.md of a library.

    Raises:
        DefinitionError: With every problem of every SKILL.md.
    """
    skills: list[SkillRuntime] = []
    problems: list[Problem] = []
    for name in library.names_of_skills():
        try:
            skills.append(read_skill(library.get_skill(name))[0])
        except DefinitionError as error:
            problems += error.problems
    if problems:
        raise DefinitionError(problems)
    return render_skills(skills)


def render_skills(skills: Sequence[SkillRuntime]) -> str:
    """SKILLRUNTIME.md."""
    front = render_front(Front(phy=SKILLRUNTIME.phy))
    if not skills:
        return f"{front}{_SKILLS_HEAD}{_NOTHING}"
    rows = ((each.skill, each.description, _code(each.guarantees), each.tree) for each in skills)
    table = render_table(("skill", "does", "guarantees", "tree"), rows)
    sections = [f"## {each.skill}\n\n{render_block(_to_plain(each))}\n" for each in skills]
    return f"{front}{_SKILLS_HEAD}{table}\n{''.join(sections)}"


def render_target_registry(library: Library) -> str:
    """TARGETS.md of a library; no worker has been started yet.

    Raises:
        DefinitionError: With every problem of every target.yaml.
    """
    targets: list[RegisteredTarget] = []
    problems: list[Problem] = []
    for name in library.names_of_targets():
        path = library.get_target(name)
        try:
            targets.append(RegisteredTarget.model_validate(read_target(path).model_dump()))
        except DefinitionError as error:
            problems += error.problems
    if problems:
        raise DefinitionError(problems)
    return render_targets(targets)


def render_targets(targets: Sequence[RegisteredTarget]) -> str:
    """TARGETS.md."""
    front = render_front(Front(phy=TARGETS.phy))
    if not targets:
        return f"{front}{_TARGETS_HEAD}{_NOTHING}"
    rows = (
        (each.target, _describe_health(each.health), each.description, each.kind, ", ".join(each.capabilities))
        for each in targets
    )
    table = render_table(("target", "health", "is", "kind", "capabilities"), rows)
    sections = [f"## {each.target}\n\n{render_block(_to_plain(each))}\n" for each in targets]
    return f"{front}{_TARGETS_HEAD}{table}\n{''.join(sections)}"


def publish_health(path: Path, health: Mapping[str, TargetHealth]) -> bool:
    """Renew the health of some targets in TARGETS.md; what a person changed in a block stays.

    Returns:
        Whether it was written: not when only the time would change, nor while it cannot be read or lacks one of them.
    """
    try:
        targets = read_targets(path.read_text(encoding="utf-8"), str(path)).blocks
    except (DefinitionError, OSError, UnicodeDecodeError):
        return False
    if not health.keys() <= targets.keys():
        return False
    changed = {
        name: each.model_copy(update={"health": health[name]})
        for name, each in targets.items()
        if name in health and (each.health.state, each.health.session) != (health[name].state, health[name].session)
    }
    if changed:
        publish(path, render_targets([changed.get(name, each) for name, each in targets.items()]))
    return bool(changed)


def read_target(path: Path) -> TargetProfile:
    """Read `robots/<name>/target.yaml`.

    Raises:
        DefinitionError: With every problem of the file.
    """
    located = read_yaml(path)
    profile = validate(TargetProfile, located)
    if profile.target != path.parent.name:
        raise DefinitionError(
            located.problem(
                "NAME_MISMATCH", ("target",), repr(profile.target), f"the folder's name {path.parent.name!r}"
            )
        )
    return profile


def read_skill_registry(path: Path) -> dict[str, SkillRuntime]:
    """Every skill of SKILLRUNTIME.md, by name.

    Raises:
        DefinitionError: With every problem of the document.
    """
    return _read(path, SKILLRUNTIME)


def read_target_registry(path: Path) -> dict[str, TargetProfile]:
    """Every profile of TARGETS.md, by name; `model` is relative to `library/robots/<target>/`.

    Raises:
        DefinitionError: With every problem of the document.
    """
    targets = _read(path, TARGETS)
    return {name: TargetProfile.model_validate(each.model_dump(exclude={"health"})) for name, each in targets.items()}


def _read(path: Path, format: DocumentFormat[_BlockT]) -> dict[str, _BlockT]:
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise DefinitionError(
            Problem(code="UNREADABLE_FILE", address=str(path), found=str(error), hint="Is this a workspace?")
        ) from error
    return read_document(text, format, str(path)).blocks


def _to_plain(entry: Authored) -> dict[str, Any]:
    return entry.model_dump(mode="json", exclude_defaults=True, by_alias=True)


def _describe_health(health: TargetHealth) -> str:
    since = f" since {format_moment(health.since)}" if health.since else ""
    session = f" ({health.session})" if health.session else ""
    return f"{health.state.value.replace('_', ' ')}{session}{since}"


def _code(texts: Iterable[str]) -> str:
    return ", ".join(f"`{text}`" for text in texts)
