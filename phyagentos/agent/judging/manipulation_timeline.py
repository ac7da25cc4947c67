"""What a session did to its object, from evidence: stage of the skill, and motion of the object."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from phyagentos.protocol.sessions.evidence import AFTER, BEFORE, EXECUTION, TRACE, Bundle
from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.sessions.trace import Role, TraceEvent
from phyagentos.protocol.sessions.verdicts import Support
from phyagentos.protocol.world.environment import Entity

_GRIPPING = frozenset({Role.PLAN_GRASP, Role.VERIFY, Role.CARRY, Role.RELEASE})  # closed fingers push, too


class Stage(IntEnum):
    """How far a skill of manipulation came with its object."""

    BEFORE = 0  # fingers still open
    CLOSED = 1  # fingers closed
    GRASPED = 2  # both fingers touched the object
    LIFTED = 3  # still held after lifting
    RELEASED = 4  # fingers opened


@dataclass(frozen=True, slots=True, kw_only=True)
class ManipulationTimeline:
    """Stage of the skill, and motion of its object, as it was before the session and is after it.

    Attributes:
        grips: Whether the skill grasps at all.
        moved_m: From before to after [m]; 0 when one of them is missing.
        since_release_m: From the release to now [m]; 0 without a release.
        support: Where these numbers stand.
    """

    name: str | None
    was: Entity | None
    now: Entity | None
    stage: Stage
    grips: bool
    moved_m: float
    since_release_m: float
    support: tuple[Support, ...]

    @classmethod
    def of(cls, bundle: Bundle, name: str | None) -> "ManipulationTimeline":
        """Read it off a bundle."""
        was = bundle.before.entities.get(name) if name and bundle.before else None
        now = bundle.after.entities.get(name) if name and bundle.after else None
        stage = _find_stage(bundle)
        sites = [e.numbers.get("position_m") for e in _iter_own(bundle) if e.role is Role.RELEASE and e.is_success]
        released = sites[-1] if sites and stage is Stage.RELEASED else None  # where the leaf saw it (3,) [m]
        since_m = math.dist(released, now.pose.position_m) if released and now else 0.0
        return cls(
            name=name,
            was=was,
            now=now,
            stage=stage,
            grips=not bundle.trace or any(event.role in _GRIPPING for event in bundle.trace),
            moved_m=compute_move(was, now),
            since_release_m=since_m,
            support=_find_support(bundle, name, was, now, stage, since_m),
        )


def compute_move(was: Entity | None, now: Entity | None) -> float:
    """Between two sightings of an object [m]; 0 when one of them is missing."""
    return math.dist(was.pose.position_m, now.pose.position_m) if was and now else 0.0


def find_failed_leaf(bundle: Bundle) -> TraceEvent | None:
    """The last failure of the leaf that decided the end of the execution."""
    failures = (event for event in reversed(bundle.trace) if event.status == "FAILURE")
    return next((event for event in failures if event.path == bundle.execution.leaf), None)


def _find_stage(bundle: Bundle) -> Stage:
    stage, checks = Stage.BEFORE, 0
    for event in _iter_own(bundle):
        match event.role if event.is_success else None:
            case Role.GRASP:
                stage, checks = Stage.CLOSED, 0
            case Role.VERIFY:
                checks += 1
                stage = Stage.GRASPED if checks == 1 else Stage.LIFTED
            case Role.CARRY:
                stage = Stage.LIFTED
            case Role.RELEASE:
                stage = Stage.RELEASED
            case Role.OPEN if stage is Stage.LIFTED:
                stage = Stage.RELEASED
    if not bundle.trace and bundle.execution.code == "GRASP_LOST":
        return Stage.LIFTED  # the skill's own word, where nothing else was recorded
    if not bundle.trace and bundle.execution.ended is Ended.COMPLETED:
        return Stage.RELEASED
    return stage


def _iter_own(bundle: Bundle) -> Iterator[TraceEvent]:
    """The trace without what was done to objects that were only moved out of the way."""
    away, about = set[str](), ""
    for event in bundle.trace:
        away |= set(event.numbers.get("things", ())) if event.role is Role.PLAN_ROOM else set()
        about = event.numbers.get("object", about)
        if about not in away:
            yield event


def _find_support(
    bundle: Bundle, name: str | None, was: Entity | None, now: Entity | None, stage: Stage, since_m: float
) -> tuple[Support, ...]:
    execution, leaf = bundle.execution, find_failed_leaf(bundle)
    item, path, numbers = f"entities.{name}", leaf.path if leaf else "", leaf.numbers if leaf else {}
    found: list[tuple[str, str, Any]] = [
        (EXECUTION, "ended", str(execution.ended)),
        (EXECUTION, "code", execution.code or None),
        *((TRACE, f"{path}.{key}", each) for key, each in numbers.items() if isinstance(each, float | int | str)),
        (TRACE, "stage", stage.name.lower() if bundle.trace else None),
        (BEFORE, f"{item}.pose.position_m", _format(was) if was else None),
        (AFTER, f"{item}.pose.position_m", _format(now) if now else None),
        (AFTER, f"{item}.visible", now.visible if now else None),
        (AFTER, item, "absent" if name and now is None else None),
        (TRACE, "metres moved since release", round(since_m, 4) if since_m else None),
    ]
    return tuple(Support(file=file, field=field, value=value) for file, field, value in found if value is not None)


def _format(entity: Entity) -> str:
    return ", ".join(f"{value:.3f}" for value in entity.pose.position_m)
