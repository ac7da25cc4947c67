"""What a person means by a name: a goal, a node or a session of a ledger. The part after the goal is enough."""

from collections.abc import Iterable, Mapping

from phyagentos.errors import DefinitionError, format_hint, format_names
from phyagentos.protocol.sessions.session import GoalId, SessionId
from phyagentos.protocol.sessions.tasks import GoalStatus


def get_goal(text: str, where: str, known: Mapping[GoalId, GoalStatus]) -> GoalStatus:
    """The goal that is called so, or the only one; raises `UNKNOWN_NAME`, which names `where`."""
    if (goal := known.get(GoalId(text)) if text else None) is not None:
        return goal
    if not text and len(known) == 1:
        return next(iter(known.values()))
    found = repr(text) if text else f"{len(known)} goals"
    expected = format_names(known) if known else "a goal that was submitted there"
    raise DefinitionError.of("UNKNOWN_NAME", where, found, expected, format_hint(text, known), "goal")


def find_node(text: str, goals: Mapping[GoalId, GoalStatus]) -> tuple[GoalStatus | None, str]:
    """The latest goal with a node that is called so, `blue` or `tidy-7.blue`, and its name there."""
    for goal in reversed(list(goals.values())):
        name = text.removeprefix(f"{goal.id}.")
        if name in goal.nodes:
            return goal, name
    return None, text


def get_session(text: str, known: Iterable[SessionId]) -> SessionId:
    """The id that a person means: this one, or the only one that ends with `.<text>`; raises `UNKNOWN_NAME`."""
    ids = list(known)
    found = [id for id in ids if id == text or id.split(".", 1)[-1] == text]
    if len(found) == 1:
        return found[0]
    problem = "several sessions are called that" if found else "no such session"
    hint = f"The newest is {found[-1]}." if found else format_hint(text, [*ids, *(id.split(".", 1)[-1] for id in ids)])
    raise DefinitionError.of("UNKNOWN_NAME", text, problem, format_names(found or ids), hint, "session")
