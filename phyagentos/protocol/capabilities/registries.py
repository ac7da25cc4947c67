"""SKILLRUNTIME.md and TARGETS.md: what this workspace can run and on what, generated and read back.

One `## name` and one YAML block an entry.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

from phyagentos.errors import DefinitionError, Problem, get_known, raise_any
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.policy_descriptors import MODEL_SCHEME
from phyagentos.protocol.capabilities.skill_runtimes import SKILLRUNTIME, SkillRuntime, read_skill
from phyagentos.protocol.capabilities.targets import TARGETS, RegisteredTarget, TargetHealth, TargetProfile
from phyagentos.protocol.documents.document import DocumentFormat, Front, read_document
from phyagentos.protocol.documents.markdown import format_moment, publish, render_block, render_front, render_table
from phyagentos.protocol.documents.schema import Authored, parse_library_yaml, read_text, validate

_BlockT = TypeVar("_BlockT")
_EntryT = TypeVar("_EntryT")

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
    """SKILLRUNTIME.md of a library; raises DefinitionError with every problem of every SKILL.md."""
    return render_skills(_read_all(library.names_of_skills(), lambda name: read_skill(library.get_skill(name))[0]))


def locate_models(skills: Mapping[str, SkillRuntime], library: Library) -> dict[str, SkillRuntime]:
    """The skills, with the whole path of each model that stands beside its SKILL.md."""
    prefix, located = f"{MODEL_SCHEME}:", dict(skills)
    for name, skill in skills.items():
        if skill.policy is not None and skill.policy.endpoint.startswith(prefix):
            path = library.get_skill(name).parent / skill.policy.endpoint.removeprefix(prefix)
            policy = skill.policy.model_copy(update={"endpoint": f"{prefix}{path}"})
            located[name] = skill.model_copy(update={"policy": policy})
    return located


def render_skills(skills: Sequence[SkillRuntime]) -> str:
    """SKILLRUNTIME.md."""
    promises = [", ".join(f"`{text}`" for text in each.guarantees) for each in skills]
    rows = [(each.skill, each.description, text, each.tree) for each, text in zip(skills, promises, strict=True)]
    return _render(SKILLRUNTIME, _SKILLS_HEAD, ("skill", "does", "guarantees", "tree"), rows, skills)


def render_target_registry(library: Library) -> str:
    """TARGETS.md of a library, no worker started; raises DefinitionError with every problem of every target.yaml."""
    profiles = _read_all(library.names_of_targets(), lambda name: read_target(library.get_target(name)))
    return render_targets([RegisteredTarget.model_validate(each.model_dump()) for each in profiles])


def render_targets(targets: Sequence[RegisteredTarget]) -> str:
    """TARGETS.md."""
    rows = [
        (each.target, _describe_health(each.health), each.description, each.kind, ", ".join(each.capabilities))
        for each in targets
    ]
    return _render(TARGETS, _TARGETS_HEAD, ("target", "health", "is", "kind", "capabilities"), rows, targets)


def publish_health(path: Path, health: Mapping[str, TargetHealth]) -> bool:
    """Renew the health of some targets in TARGETS.md; what a person changed in a block stays.

    Returns:
        Whether it was written: not when only the time would change, nor while it cannot be read or lacks one of them.
    """
    try:
        targets = read_document(read_text(path), TARGETS, str(path)).blocks
    except DefinitionError:
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
    """Read `robots/<name>/target.yaml`; raises DefinitionError with every problem at file:line:column."""
    return _read_target(read_text(path), path)


@lru_cache(maxsize=128)  # a library is read anew by each part of a process
def _read_target(text: str, path: Path) -> TargetProfile:
    located = parse_library_yaml(text, str(path))
    profile = validate(TargetProfile, located)
    if profile.target != path.parent.name:
        expected, hint = f"the folder's name {path.parent.name!r}", f"Write {path.parent.name!r}, or rename the folder."
        raise DefinitionError(located.problem("INVALID_VALUE", ("target",), repr(profile.target), expected, hint))
    return profile


def read_skill_registry(path: Path) -> dict[str, SkillRuntime]:
    """Every skill of SKILLRUNTIME.md, by name; raises DefinitionError with every problem at file:line:column."""
    return _read(path, SKILLRUNTIME)


def read_target_registry(path: Path) -> dict[str, TargetProfile]:
    """Every profile of TARGETS.md, by name; `model` is relative to `library/robots/<target>/`."""
    targets = _read(path, TARGETS)
    return {name: TargetProfile.model_validate(each.model_dump(exclude={"health"})) for name, each in targets.items()}


def get_registered_target(path: Path, name: str) -> TargetProfile:
    """One profile of TARGETS.md; raises DefinitionError `UNKNOWN_NAME` where it holds none of that name."""
    return get_known("target", str(path), name, read_target_registry(path))


def _read(path: Path, format: DocumentFormat[_BlockT]) -> dict[str, _BlockT]:
    return read_document(read_text(path, hint="Is this a workspace?"), format, str(path)).blocks


def read_each(names: Iterable[str], read: Callable[[str], _EntryT]) -> tuple[dict[str, _EntryT], list[Problem]]:
    """The entries that can be read, and the problems of the others."""
    found: dict[str, _EntryT] = {}
    problems: list[Problem] = []
    for name in names:
        try:
            found[name] = read(name)
        except DefinitionError as error:
            problems += error.problems
    return found, problems


def _read_all(names: Iterable[str], read: Callable[[str], _EntryT]) -> list[_EntryT]:
    """Every entry; raises DefinitionError with the problems of all files."""
    entries, problems = read_each(names, read)
    raise_any(problems)
    return list(entries.values())


def _render(
    format: DocumentFormat[_BlockT],
    head: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    entries: Sequence[Authored],
) -> str:
    """A registry: a table, and a section for each entry; the first column holds their names."""
    front = render_front(Front(phy=format.phy))
    if not entries:
        return f"{front}{head}{_NOTHING}"
    blocks = (render_block(each.model_dump(mode="json", exclude_defaults=True, by_alias=True)) for each in entries)
    sections = [f"## {row[0]}\n\n{block}\n" for row, block in zip(rows, blocks, strict=True)]
    return f"{front}{head}{render_table(columns, rows)}\n{''.join(sections)}"


def _describe_health(health: TargetHealth) -> str:
    since = f" since {format_moment(health.since)}" if health.since else ""
    session = f" ({health.session})" if health.session else ""
    return f"{health.state.value.replace('_', ' ')}{session}{since}"
