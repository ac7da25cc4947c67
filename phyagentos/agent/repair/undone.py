"""What no longer holds: achievements of finished nodes that the world has undone, and preconditions that are lost.

Upstream: the latest snapshot. Downstream: `progress`, which opens such nodes again, and the revision of a child.
"""

from collections.abc import Mapping, Sequence

from phyagentos.protocol.environment import Environment
from phyagentos.protocol.predicates.predicate import Predicate, View, iter_entities, parse_predicate
from phyagentos.protocol.sessions import Session
from phyagentos.protocol.verdicts import Truth


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
