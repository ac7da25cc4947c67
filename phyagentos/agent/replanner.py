"""The replanner: what a child session does differently, and which finished nodes the world has undone. Section 4.2.

Upstream: a verdict `replan`, or a goal that does not hold at its end. Downstream: the compiler. The parent is never
touched; the child begins with the world as it is.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from phyagentos.agent.compiler import Revision
from phyagentos.agent.diagnosis import Cause, find_object
from phyagentos.protocol.environment import Environment
from phyagentos.protocol.evidence import Bundle
from phyagentos.protocol.predicates.predicate import Predicate, View, iter_entities, parse_predicate
from phyagentos.protocol.sessions import Session
from phyagentos.protocol.verdicts import Attempt, Truth

SLOWER = 0.5  # physics: at half speed a slippery 0.5 kg cube stays in the fingers in 59 of 60 transports
SLOWEST = 0.25

_AVOID_GRASP = frozenset({Cause.GRASP_MISSED, Cause.GRASP_LOST})
_AVOID_SITE = frozenset({Cause.PLACED_WRONG, Cause.STILL_HELD})
_GO_SLOWER = frozenset({Cause.GRASP_LOST, Cause.PLACED_WRONG, Cause.CONSTRAINT_VIOLATED, Cause.SAFETY_STOP})


def revise(bundle: Bundle, attempt: Attempt) -> Revision:
    """The revision that answers a verdict `replan`.

    Args:
        bundle: Evidence of the session that is continued.
        attempt: Its judgement.
    """
    parent, cause = bundle.session, Cause(attempt.cause)
    strategy: dict[str, Any] = dict(parent.strategy)
    reasons = [f"{cause.value}: {attempt.reason}"]
    if cause in _AVOID_GRASP and (grasp := find_label(bundle, "plan_grasp")):
        strategy["avoid_grasps"] = _extend(strategy.get("avoid_grasps", ()), grasp)
        reasons.append(f"another grasp than {grasp}")
    if cause in _AVOID_SITE and (site := find_label(bundle, "plan_place")):
        strategy["avoid_sites"] = _extend(strategy.get("avoid_sites", ()), site)
        reasons.append(f"another site than {site}")
    if cause in _GO_SLOWER:
        strategy["speed"] = max(SLOWEST, float(strategy.get("speed", 1.0)) * SLOWER)
        reasons.append(f"at {strategy['speed']:g} of the speed")
    if cause is Cause.NO_PLAN:
        given_up = [key for key in ("avoid_grasps", "avoid_sites") if strategy.pop(key, None)]
        reasons += [f"{key} given up: nothing else was found" for key in given_up]
    requires, changes = _revise_requires(bundle)
    return Revision(parent=parent.id, strategy=strategy, requires=requires, reasons=(*reasons, *changes))


def find_label(bundle: Bundle, planner: str) -> str | None:
    """Label of the approach that was last carried out, of those that a planning leaf had found.

    Args:
        bundle: Where the trace is.
        planner: Type of the planning leaf (`plan_grasp`, `plan_place`).
    """
    found: set[str] = set()
    chosen = None
    for event in bundle.trace:
        if event.leaf == planner and event.status == "SUCCESS":
            found = set(event.numbers.get("labels", ()))
        elif event.numbers.get("label") in found:
            chosen = str(event.numbers["label"])
    return chosen


def find_undone(
    finished: Mapping[str, Session], order: Sequence[str], now: Environment, initial: Environment | None
) -> dict[str, str]:
    """Finished nodes whose achievement no longer holds -> the fact that shows it.

    Only lasting facts count (`inside`, not `holding`), and none about a thing that a later node took up again.

    Args:
        finished: Node -> its latest succeeded session.
        order: Names of all nodes, in the order of the graph.
        now: The latest snapshot.
        initial: The goal's first snapshot.
    """
    undone = {}
    for index, name in enumerate(order):
        session = finished.get(name)
        if session is None:
            continue
        later = {
            value
            for other in order[index + 1 :]
            if other in finished
            for value in finished[other].parameters.values()
            if isinstance(value, str) and finished[other].parameters.get("object") == value
        }
        view = View(now=now, initial=initial, target=session.target)
        for text in session.accept:
            predicate = parse_predicate(text)
            subject = next(iter_entities(predicate), None)
            if not predicate.is_lasting or subject in later:
                continue
            evaluation = predicate.evaluate(view)
            if evaluation.truth is Truth.FALSE:
                undone[name] = f"{text} no longer holds: {evaluation.because}"
                break
    return undone


def find_lost_preconditions(session: Session, now: Environment) -> tuple[Predicate, ...]:
    """Preconditions of a contract that are false in the present world."""
    view = View(now=now, initial=now, target=session.target)
    predicates = (parse_predicate(text) for text in session.requires)
    return tuple(predicate for predicate in predicates if predicate.evaluate(view).truth is Truth.FALSE)


def _revise_requires(bundle: Bundle) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Preconditions of the child: where things stood before no longer matters, that the object is seen does."""
    session = bundle.session
    lost = find_lost_preconditions(session, bundle.after) if bundle.after else ()
    dropped = tuple(predicate.text for predicate in lost if predicate.is_lasting)
    reasons = [f"{text} is no longer required: it was true before the parent and is not now" for text in dropped]
    requires = [text for text in session.requires if text not in dropped]
    name = find_object(bundle)
    if name and f"visible({name})" not in requires:
        requires.append(f"visible({name})")
        reasons.append(f"visible({name}) is required: the child locates it anew")
    return tuple(requires), tuple(reasons)


def _extend(labels: Sequence[str], label: str) -> list[str]:
    return [*labels, label] if label not in labels else list(labels)
