"""Entries of 0.1.x, converted to drafts: goal graphs, targets, skills with their trees, and a scene.

Upstream: `documents`. Downstream: `importer`. A draft is complete enough for `paos lint` and claims nothing: each node
is accepted by `unstated()`, which no evidence can make true, and each skill's tree fails until somebody writes it.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.legacy.documents import Document, Entry, read_entries
from phyagentos.protocol.legacy.drafts import (
    PHYSICS_STEP_S,
    render_scene,
    render_skill,
    render_target,
    render_tree,
    to_comment,
)
from phyagentos.protocol.legacy.entries import LegacyContract, LegacySession, LegacySkill, LegacyState, LegacyTarget
from phyagentos.protocol.legacy.fields import KINDS
from phyagentos.protocol.legacy.history import render_history
from phyagentos.protocol.legacy.remarks import (
    Remark,
    RemarkKind,
    iter_document_remarks,
    iter_field_remarks,
    remark,
)
from phyagentos.protocol.schema import validate
from phyagentos.protocol.store.bodies import render_yaml

SCENE = "imported"
NO_GOAL = "imported"
_SESSIONS, _TARGETS, _SKILLS, _CONTRACTS = KINDS
_RESERVED = frozenset({"any", "target"})  # words of goal graphs
_NO_ENTRY = "no entry of that name is among the sources, so a bare draft was written"
_PRIORITIES = {"low": -1, "normal": 0, "high": 1}
_TARGET_KINDS = {"sim": "simulation", "game": "debug"}  # the others are called the same


@dataclass(frozen=True, slots=True, kw_only=True)
class Draft:
    """What an import would write.

    Attributes:
        files: Path below `project/` -> text.
        history: HISTORY.md; empty when every session is pending.
        remarks: What was not carried over, in the order of the files.
        pending: Sessions that became nodes.
        past: Sessions that became history.
    """

    files: Mapping[str, str]
    history: str
    remarks: tuple[Remark, ...]
    pending: int
    past: int


def convert(documents: Iterable[Document]) -> Draft:
    """Convert everything, or nothing.

    Raises:
        DefinitionError: With every problem of every entry.
    """
    documents = list(documents)
    return _Conversion(read_entries(documents)).run(documents)


@dataclass(slots=True)
class _Names:
    """New names for old ones: each unique, each a name here."""

    taken: dict[str, str] = field(default_factory=dict)  # new -> old
    known: dict[str, str] = field(default_factory=dict)  # old -> new

    def get(self, old: str) -> str:
        if old not in self.known:
            stem = re.sub(r"[^a-z0-9]+", "_", old.lower()).strip("_") or "unnamed"
            stem = f"n_{stem}" if stem[0].isdigit() else stem
            new, number = stem, 2
            while new in self.taken or new in _RESERVED:
                new, number = f"{stem}_{number}", number + 1
            self.taken[new], self.known[old] = old, new
        return self.known[old]


class _Conversion:
    """One conversion."""

    def __init__(self, entries: list[Entry]) -> None:
        self._entries = entries
        self._problems: list[Problem] = []
        self._remarks: list[Remark] = []
        self._files: dict[str, str] = {}
        self._targets, self._skills, self._goals, self._nodes = _Names(), _Names(), _Names(), _Names()
        self._edges: dict[str, set[str]] = {}  # node -> nodes that come before it

    def run(self, documents: list[Document]) -> Draft:
        pending: list[Entry] = []
        past: list[Entry] = []
        for entry in self._of(_SESSIONS):
            state = self._read(LegacyState, entry)
            if state is not None:
                (pending if state.status == "pending" else past).append(entry)
        history = {id(entry) for entry in past}
        self._remarks += iter_document_remarks(documents)
        for entry in self._entries:
            self._remarks += iter_field_remarks(entry, is_history=id(entry) in history)
        self._convert_targets()
        for entry in self._of(_SKILLS):
            self._convert_skill(entry)
        self._convert_sessions(pending)
        if self._problems:
            raise DefinitionError(self._problems)
        return Draft(
            files=self._files,
            history=render_history(past),
            remarks=tuple(self._remarks),
            pending=len(pending),
            past=len(past),
        )

    def _of(self, version: str) -> list[Entry]:
        return [entry for entry in self._entries if entry.kind.version == version]

    def _read(self, model: Any, entry: Entry) -> Any:
        """The fields that are converted, or None after their problems were taken down."""
        try:
            return validate(model, entry.located, entry.path)
        except DefinitionError as error:
            self._problems += error.problems
            return None

    def _name(self, names: _Names, old: str, entry: Entry, step: str) -> str:
        is_new = old not in names.known
        new = names.get(old)
        if is_new and new != old:
            self._remarks.append(remark(RemarkKind.RENAMED, entry, f"{old!r} is {new!r} here", step))
        return new

    def _convert_targets(self) -> None:
        contracts = {
            contract.target_id: (entry, contract)
            for entry in self._of(_CONTRACTS)
            if (contract := self._read(LegacyContract, entry))
        }
        for entry in self._of(_TARGETS):
            target = self._read(LegacyTarget, entry)
            if target is None:
                continue
            name = self._name(self._targets, target.id, entry, "id")
            found = contracts.pop(target.id, None)
            period_s = self._find_period(*found) if found else None
            if found is None and target.runtime is not None and target.runtime.runtime_contract_ref:
                reason = "no contract of this target is among the sources"
                self._remarks.append(remark(RemarkKind.NOT_MAPPED, entry, reason, "runtime", "runtime_contract_ref"))
            old = target.target_kind or target.type or "simulation"
            kind = _TARGET_KINDS.get(old, old)
            self._write_target(name, entry, "id", kind=kind, embodiment=target.embodiment or "arm", period_s=period_s)
        for entry, contract in contracts.values():
            reason = f"no target {contract.target_id!r} is among the sources"
            self._remarks.append(remark(RemarkKind.NOT_MAPPED, entry, reason, "target_id"))

    def _find_period(self, entry: Entry, contract: LegacyContract) -> float | None:
        hz = contract.action_contract.control_hz if contract.action_contract else None
        if hz is None:
            return None
        steps = 1.0 / hz / PHYSICS_STEP_S
        if abs(steps - round(steps)) > 1e-6 or round(steps) < 1:
            reason = f"{hz:g} Hz is no whole number of physics steps of {PHYSICS_STEP_S:g} s; the default stands"
            self._remarks.append(remark(RemarkKind.NOT_MAPPED, entry, reason, "action_contract", "control_hz"))
            return None
        return round(round(steps) * PHYSICS_STEP_S, 6)

    def _write_target(
        self,
        name: str,
        entry: Entry,
        step: str,
        *,
        kind: str = "simulation",
        embodiment: str = "arm",
        period_s: float | None = None,
    ) -> None:
        text = render_target(name, kind, embodiment, period_s, entry.address_of(step))
        self._files[f"robots/{name}/target.yaml"] = text
        self._remarks.append(remark(RemarkKind.ASSUMED, entry, "model, arm and gripper are empty: fill them in", step))

    def _convert_skill(self, entry: Entry) -> None:
        skill = self._read(LegacySkill, entry)
        if skill is not None:
            name = self._name(self._skills, skill.id, entry, "id")
            self._write_skill(name, skill.runtime_kind, entry, "id")

    def _write_skill(self, name: str, kind: str, entry: Entry, step: str) -> None:
        at = entry.address_of(step)
        self._files[f"skills/{name}/SKILL.md"] = render_skill(name, kind, at)
        self._files[f"trees/{name}.yaml"] = render_tree(name, at)
        self._remarks.append(remark(RemarkKind.ASSUMED, entry, "its tree fails until it is written", step))

    def _convert_sessions(self, pending: list[Entry]) -> None:
        sessions = [(entry, session) for entry in pending if (session := self._read(LegacySession, entry))]
        goals: dict[str, list[tuple[Entry, LegacySession]]] = {}
        goal_of = {session.session_id: session.goal_id or "" for _, session in sessions}
        for entry, session in sessions:
            goals.setdefault(session.goal_id or "", []).append((entry, session))
            self._name(self._nodes, session.session_id, entry, "session_id")
        for goal, members in goals.items():
            self._write_goal(goal, members, goal_of)
        if goals:
            self._files[f"scenes/{SCENE}.yaml"] = render_scene(SCENE)

    def _write_goal(self, goal: str, members: list[tuple[Entry, LegacySession]], goal_of: Mapping[str, str]) -> None:
        first = members[0][0]
        name = self._name(self._goals, goal, first, "goal_id") if goal else self._goals.get(NO_GOAL)
        lines = [
            f"# Imported from {to_comment(first.located.source)}: a draft, of which nothing has run here.",
            "# Name a scene, complete targets and skills, and write what decides in the place of each unstated().",
            render_yaml(
                {
                    "goal": name,
                    "objective": f"Imported from 0.1.x: {goal or 'sessions without a goal'}.",
                    "scene": SCENE,
                }
            ).rstrip("\n"),
            "sessions:",
        ]
        for entry, session in members:
            lines += self._render_node(entry, session, goal_of)
        self._files[f"goal_graphs/{name}.yaml"] = "\n".join(lines) + "\n"
        self._remarks.append(
            remark(RemarkKind.ASSUMED, first, f"scene {SCENE!r}, an empty world: name yours", "goal_id")
        )

    def _render_node(self, entry: Entry, session: LegacySession, goal_of: Mapping[str, str]) -> list[str]:
        name = self._nodes.get(session.session_id)
        priority = _PRIORITIES[session.priority or "normal"]
        node: dict[str, Any] = {
            "objective": session.task_description or f"Imported session {session.session_id}.",
            "skill": self._find_skill(entry, session),
            "target": self._find_target(entry, session),
            "after": self._find_edges(entry, session, goal_of),
            "accept": ["unstated()"],
            "timeout_s": session.timeouts.execute_timeout_s if session.timeouts else None,
            "max_replans": session.retry.max_retries if session.retry else None,
            "priority": priority or None,
        }
        text = render_yaml({name: {key: value for key, value in node.items() if value not in (None, [])}})
        self._remarks.append(
            remark(RemarkKind.ASSUMED, entry, "acceptance `unstated()`: write a predicate", "session_id")
        )
        comments = [f"  # was {to_comment(session.session_id)}, {to_comment(entry.address_of())}"]
        comments += [f"  #   {to_comment(line)}" for line in _iter_criteria(entry.data)]
        return [*comments, *(f"  {line}" for line in text.splitlines())]

    def _find_skill(self, entry: Entry, session: LegacySession) -> str:
        step = "skillruntime_ref" if session.skillruntime_ref else "skill_ref"
        old = (session.skillruntime_ref or session.skill_ref or "").split("://")[-1]
        if not old:
            self._problems.append(
                Problem(
                    code="MISSING_KEY",
                    address=entry.address_of(),
                    found="nothing",
                    expected="key 'skillruntime_ref'",
                    hint="Add 'skillruntime_ref'.",
                )
            )
        is_new = old not in self._skills.known
        name = self._name(self._skills, old, entry, step)
        if is_new:
            self._remarks.append(remark(RemarkKind.ASSUMED, entry, f"{_NO_ENTRY}: {old!r}", step))
            self._write_skill(name, "builtin", entry, step)
        return name

    def _find_target(self, entry: Entry, session: LegacySession) -> str:
        old = session.target_ref.split("://")[-1]
        is_new = old not in self._targets.known
        name = self._name(self._targets, old, entry, "target_ref")
        if is_new:
            self._remarks.append(remark(RemarkKind.ASSUMED, entry, f"{_NO_ENTRY}: {old!r}", "target_ref"))
            self._write_target(name, entry, "target_ref")
        return name

    def _find_edges(self, entry: Entry, session: LegacySession, goal_of: Mapping[str, str]) -> list[str]:
        """Sessions that come before, as far as they are pending, of the same goal, and close no cycle."""
        after: list[str] = []
        for index, before in enumerate(session.depends_on or ()):
            if before not in goal_of:
                reason = f"{before!r} is not pending; what 0.1.x claims of it was never verified here"
            elif goal_of[before] != goal_of[session.session_id]:
                reason = f"{before!r} belongs to another goal"
            elif self._reaches(before, session.session_id):
                reason = f"{before!r} waits for this session itself: a cycle"
            else:
                self._edges.setdefault(session.session_id, set()).add(before)
                after += [name for name in [self._nodes.get(before)] if name not in after]
                continue
            self._remarks.append(remark(RemarkKind.NOT_MAPPED, entry, reason, "depends_on", index))
        return after

    def _reaches(self, start: str, goal: str) -> bool:
        """Whether `start` waits for `goal`, directly or not."""
        waiting, seen = [start], set()
        while waiting:
            here = waiting.pop()
            if here == goal:
                return True
            if here not in seen:
                seen.add(here)
                waiting += self._edges.get(here, ())
        return False


def _iter_criteria(data: Mapping[Any, Any]) -> Iterable[str]:
    """What the session says about its own verification, as text."""
    contract = data.get("verification")
    if not isinstance(contract, dict):
        return
    for key in ("goal", "success_criteria", "constraints"):
        value = contract.get(key)
        for text in value if isinstance(value, list) else [value] if value else []:
            yield f"{key}: {text}"
