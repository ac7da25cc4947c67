"""SKILLRUNTIME.md and TARGETS.md: what this workspace can run and on what, generated and read back.

Upstream: SKILL.md files and target profiles of the workspace's library. Downstream: the agent's selector and compiler,
preflight. One `## name` and one YAML block an entry.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.document import iter_blocks
from phyagentos.protocol.library import Library
from phyagentos.protocol.markdown import render_table
from phyagentos.protocol.schema import Authored, parse_yaml, read_yaml, validate
from phyagentos.protocol.skill_runtimes import SkillRuntime, read_skill
from phyagentos.protocol.store.bodies import render_yaml
from phyagentos.protocol.targets import TargetProfile

_ModelT = TypeVar("_ModelT", bound=Authored)

_SKILLS_HEAD = """# Skills that this workspace can run

Generated from the front matter of `library/skills/*/SKILL.md`: parameters, what must hold before and during, what the
skill guarantees, what it needs of a target, and the behaviour tree that carries it out. To change a skill, edit its
SKILL.md.

"""
_TARGETS_HEAD = """# Targets of this workspace

Generated from `library/robots/*/target.yaml`: embodiment, control period, observations, actions, capabilities. What a
target *may* do is not here: the limits that the guard enforces are in `safety.yaml`.

"""


def render_skill_registry(library: Library) -> str:
    """SKILLRUNTIME.md.

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
    rows = ((each.skill, each.description, _code(each.guarantees), each.tree) for each in skills)
    table = render_table(("skill", "does", "guarantees", "tree"), rows)
    return f"{_SKILLS_HEAD}{table}\n" + "".join(_render_entry(each.skill, each) for each in skills)


def render_target_registry(library: Library) -> str:
    """TARGETS.md.

    Raises:
        DefinitionError: With every problem of every target.yaml.
    """
    targets: list[TargetProfile] = []
    problems: list[Problem] = []
    for name in library.names_of_targets():
        path = library.get_target(name)
        try:
            targets.append(read_target(path))
        except DefinitionError as error:
            problems += error.problems
    if problems:
        raise DefinitionError(problems)
    rows = ((each.target, each.description, each.kind, ", ".join(each.capabilities)) for each in targets)
    table = render_table(("target", "is", "kind", "capabilities"), rows)
    return f"{_TARGETS_HEAD}{table}\n" + "".join(_render_entry(each.target, each) for each in targets)


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
    return _read_entries(path, SkillRuntime)


def read_target_registry(path: Path) -> dict[str, TargetProfile]:
    """Every target of TARGETS.md, by name; `model` is relative to `library/robots/<target>/`.

    Raises:
        DefinitionError: With every problem of the document.
    """
    return _read_entries(path, TargetProfile)


def _render_entry(name: str, entry: Authored) -> str:
    plain = entry.model_dump(mode="json", exclude_defaults=True, by_alias=True)
    return f"## {name}\n\n```yaml\n{render_yaml(plain)}```\n\n"


def _read_entries(path: Path, model: type[_ModelT]) -> dict[str, _ModelT]:
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise DefinitionError(
            Problem(code="UNREADABLE_FILE", address=str(path), found=str(error), hint="Is this a workspace?")
        ) from error
    entries: dict[str, _ModelT] = {}
    problems: list[Problem] = []
    for block in iter_blocks(text):
        try:
            entries[block.name] = validate(model, parse_yaml(block.yaml, str(path), block.line))
        except DefinitionError as error:
            problems += error.problems
    if problems:
        raise DefinitionError(problems)
    return entries


def _code(texts: Iterable[str]) -> str:
    return ", ".join(f"`{text}`" for text in texts)
