"""Scopes: where experience holds, how it is widened, and where it may be used.

A scope is widened only along what its correction is about: a place to avoid concerns the destination, speed and grasp
concern the object.
"""

import hashlib
import re
from collections.abc import Mapping

import msgspec

from phyagentos.agent.memory.episodes import Episode
from phyagentos.protocol.sessions.memory_entries import Embodiment, Scope
from phyagentos.protocol.sessions.strategy import Strategy

OF_PLACES = frozenset({"avoid_sites"})  # corrections about the destination; they do not depend on the hand
FORCE_TOLERANCE = 0.1  # grippers whose forces differ by less hold alike
_NO_WORD = re.compile(r"[^a-z0-9]+")
_ENCODER = msgspec.json.Encoder(order="deterministic")


def compute_scope(episode: Episode) -> Scope:
    """The case of one episode: everything that is known to narrow it."""
    return Scope(
        scene=episode.scene,
        skill=episode.skill,
        target=episode.target,
        object=episode.features.object_kind,
        destination=episode.features.destination_kind,
        body=episode.body,
        risk=episode.risk,
    )


def widen(scope: Scope, strategy: Strategy) -> Scope:
    """The scope without what the correction is not about; the same when there is nothing to leave out."""
    if OF_PLACES & strategy.changed:
        return msgspec.structs.replace(scope, object="") if scope.destination else scope
    return msgspec.structs.replace(scope, scene="", destination="") if scope.object else scope


def name_left_out(narrow: Scope, wide: Scope) -> str:
    """What a case has where the wider scope leaves it open: two different ones are needed to believe in the wider."""
    pairs = ((narrow.scene, wide.scene), (narrow.object, wide.object), (narrow.destination, wide.destination))
    return "/".join(case for case, general in pairs if case != general)


def find_mismatch(scope: Scope, case: Scope, strategy: Strategy) -> str:
    """Why experience of `scope` must not be used in `case`; empty when it may.

    What is empty in `scope` does not narrow it; all but places to avoid concerns the hand, and needs a similar one.
    """
    for field in ("skill", "scene", "object", "destination", "goal"):
        wanted, found = getattr(scope, field), getattr(case, field)
        if wanted and wanted != found:
            return f"{field} {found or 'unknown'}, not {wanted}"
    if scope.risk is not None and case.risk is not None and scope.risk.rank < case.risk.rank:
        return f"verified at {scope.risk} risk, not at {case.risk}"
    if scope.entities and not {case.object, case.destination} & set(scope.entities):
        return f"it is about {', '.join(scope.entities)}"
    if not scope.target or scope.target == case.target:
        return ""
    return _compare_bodies(scope.body, case.body, strategy)


def compute_id(kind: str, scope: Scope, cause: str, strategy: Mapping[str, object]) -> str:
    """Id of an entry: words for people, and a hash of all that makes it this one (`lesson-soap-grasp-lost-1f0c2a`).

    The same experience has the same id in every workspace and after every rebuild.
    """
    digest = hashlib.blake2b(_ENCODER.encode([kind, scope, cause, dict(strategy)]), digest_size=4).hexdigest()
    words = " ".join(filter(None, (kind, scope.object, scope.destination, cause))).lower()
    return f"{_NO_WORD.sub('-', words).strip('-')}-{digest}"


def measure_width(scope: Scope) -> int:
    """How many of its dimensions a scope leaves open."""
    return sum(not getattr(scope, field) for field in ("scene", "object", "destination"))


def _compare_bodies(known: Embodiment | None, found: Embodiment | None, strategy: Strategy) -> str:
    """Why what one target learned may not be used on another; empty when it may."""
    if known is None or found is None or not known.kind:
        return "another target, and it is not known in which body this was learned"
    if known.kind != found.kind:
        return f"learned with a body of kind {known.kind}, not {found.kind}"
    if strategy.changed and strategy.changed <= OF_PLACES:
        return ""
    if abs(known.grip_width_m - found.grip_width_m) > 1e-6:
        return f"learned with a gripper of {known.grip_width_m} m, not {found.grip_width_m} m"
    if abs(known.grip_force_n - found.grip_force_n) > FORCE_TOLERANCE * known.grip_force_n:
        return f"learned with {known.grip_force_n} N a finger, not {found.grip_force_n} N"
    if known.control_period_s != found.control_period_s:
        return f"learned at a control period of {known.control_period_s} s, not {found.control_period_s} s"
    return ""
