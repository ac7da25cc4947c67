"""What a workspace gives to contexts: its documents, its settings, and the goal as the ledger has it."""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

from phyagentos.agent.context.context import Section, select
from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.registries import read_skill_registry, read_target_registry
from phyagentos.protocol.documents.document import DocumentFormat, read_document
from phyagentos.protocol.documents.schema import read_text
from phyagentos.protocol.predicates.predicate import find_entities
from phyagentos.protocol.sessions.knowledge import KNOWLEDGE
from phyagentos.protocol.sessions.lessons import LESSONS, Lesson
from phyagentos.protocol.sessions.memory_entries import EntryState, MemoryEntry, Scope
from phyagentos.protocol.sessions.session import Session, SessionStatus
from phyagentos.protocol.sessions.tasks import GoalStatus, NodeState
from phyagentos.protocol.settings.safety import read_safety
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import ENVIRONMENT, Environment, Snapshot
from phyagentos.store.ledger import Ledger

_OPEN = (NodeState.ACTIVE, NodeState.BLOCKED, NodeState.READY, NodeState.INVALIDATED, NodeState.WAITING)
_EntryT = TypeVar("_EntryT", bound=MemoryEntry)


def iter_sections(workspace: Workspace, ledger: Ledger, goal: GoalStatus | None) -> Iterator[Section]:
    """Every section but the question, what a goal uses first; raises DefinitionError of an unreadable document."""
    nodes = goal.nodes if goal else {}
    sessions = [ledger.sessions[id] for node in nodes.values() for id in node.sessions if id in ledger.sessions]
    world = read_document(read_text(workspace.environment), ENVIRONMENT).blocks.get("Snapshot")
    if goal is not None:
        yield Section("request", {goal.id: select("request", goal)})
        opened = [name for state in _OPEN for name in nodes if nodes[name].state is state]
        yield Section("nodes", {name: select("nodes", nodes[name], state=nodes[name].state) for name in opened})
        judged = [each for each in sessions if each.attempts or each.problems]
        judged.sort(key=lambda each: each.updated_at, reverse=True)
        judged.sort(key=lambda each: each.contract.node not in opened)
        yield describe_attempts(judged)
    if world is not None:
        yield from _iter_world(world, goal)
    used = {name for node in nodes.values() for name in (node.skill, node.target)}
    skills: dict[str, object] = {}
    for skill in sorted(read_skill_registry(workspace.skill_registry).values(), key=lambda e: e.skill not in used):
        types = {key: each.type for key, each in skill.parameters.items()}
        skills[skill.skill] = select("skills", skill, parameters=types)
    yield Section("skills", skills)
    targets = sorted(read_target_registry(workspace.target_registry).values(), key=lambda e: e.target not in used)
    yield Section("targets", {each.target: select("targets", each) for each in targets})
    limits = read_safety(workspace.safety).targets
    bounds = ((n, path, limit) for n in limits if n in used or not goal for path, limit, _ in limits[n].iter_limits())
    yield Section("limits", {".".join((name, *path)): select("limits", limit) for name, path, limit in bounds})
    lessons, knowledge = read_active(workspace.lessons, LESSONS), read_active(workspace.knowledge, KNOWLEDGE)
    for section, active in (("lessons", lessons), ("knowledge", knowledge)):
        held = (e for e in active if not sessions or any(holds_for(e.scope, s.contract, world) for s in sessions))
        yield Section(section, {each.id: select(section, each) for each in held})


def describe_attempts(sessions: Sequence[SessionStatus]) -> Section:
    """Sessions, how they ended, and their verdicts."""
    items: dict[str, object] = {}
    for each in sessions:
        parts = (each, each.decision, each.contract, each.execution)
        shown = (select("attempts", part) for part in parts if part is not None)
        items[each.contract.id] = {name: value for part in shown for name, value in part.items()}
    return Section("attempts", items)


def find_lessons(path: Path, session: Session, world: Environment | None) -> tuple[Lesson, ...]:
    """Lessons of LESSONS.md in force for a session, in its order; none while it cannot be read."""
    try:
        return tuple(each for each in read_active(path, LESSONS) if holds_for(each.scope, session, world))
    except (OSError, DefinitionError):  # an edit of a person; memory reports it when it takes it in
        return ()


def holds_for(scope: Scope, session: Session, world: Environment | None) -> bool:
    """Whether a session falls into a scope, on the same target; what a scope leaves empty does not narrow it."""
    flat = (each if isinstance(each, list | tuple) else (each,) for each in session.parameters.values())
    names = {name for each in flat for name in each if isinstance(name, str)}
    kinds = {world.entities[name].kind for name in names & world.entities.keys()} if world else set()
    kinds |= {"region"} if world and names & world.regions.keys() else set()
    wanted = (scope.scene, scope.skill, scope.target, scope.object, scope.destination)
    found = ({session.scene.name}, {session.skill}, {session.target}, kinds, kinds)
    is_about = not scope.entities or bool((names | kinds) & set(scope.entities))
    return is_about and all(not each or each in values for each, values in zip(wanted, found, strict=True))


def read_active(path: Path, format: DocumentFormat[_EntryT]) -> tuple[_EntryT, ...]:
    """The entries of a document of memory that are in force; it is read again when it has changed."""
    return _read_active(path, format, path.stat().st_mtime_ns)


@lru_cache(maxsize=4)
def _read_active(path: Path, format: DocumentFormat[Any], _changed_ns: int) -> tuple[Any, ...]:
    entries = read_document(read_text(path), format, str(path)).blocks.values()
    return tuple(each for each in entries if each.state is EntryState.ACTIVE)


def _iter_world(world: Snapshot, goal: GoalStatus | None) -> Iterator[Section]:
    """The snapshot as a whole, then its objects: those that the goal names, what is movable, what is fixed."""
    named = {name for text in (*goal.accept, *goal.constraints) for name in find_entities(text)} if goal else set()
    true_of: dict[str, list[str]] = {}
    for each in world.relations:
        true_of.setdefault(each.arguments[0], []).append(each.text)
    robots = {name: true_of.get(name, []) for name in world.targets}
    yield Section("snapshot", {world.scene: select("snapshot", world, targets=robots)})
    objects: dict[str, object] = {}
    for item in sorted(world.entities.values(), key=lambda e: (e.name not in named, not e.movable, e.name)):
        at_m, unseen = [round(value, 4) for value in item.pose.position_m], world.explain_unseen(item)
        more = {"at_m": at_m, "unseen": unseen, "relations": true_of.get(item.name)}
        objects[item.name] = select("world", item, **more)
    yield Section("world", objects)
