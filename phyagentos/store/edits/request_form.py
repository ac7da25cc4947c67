"""What a person may request: a contract, an amendment, an end; one form for SESSIONS.md and for files of the inbox.

A session by hand serves no goal, so it has no node and no parent. A request that is recorded already becomes nothing;
what the state of the session forbids is refused by the journal.
"""

import re
from collections.abc import Mapping
from typing import Annotated

import msgspec

from phyagentos.errors import DefinitionError, Problem, raise_any
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import Located, parse_yaml
from phyagentos.protocol.documents.struct_schema import convert_located
from phyagentos.protocol.predicates.language import PredicateSyntaxError, parse
from phyagentos.protocol.sessions.lifecycle import SessionState, find_cancel
from phyagentos.protocol.sessions.session import (
    PRIORITY_MAX,
    Amendment,
    GoalId,
    Limits,
    Session,
    SessionId,
    SessionStatus,
    apply_amendment,
)
from phyagentos.store.admission import Entry
from phyagentos.store.records import JOURNAL_ID

BY_HAND = GoalId("")  # goal of a session that serves none
VALUES_MAX = 10_000  # of one request: it is read between two turns of the process that supervises
LIMIT_MAX = 1e9  # [s]
_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,119}")
_OF_AGENT = frozenset(
    {"goal", "node", "parent", "attempt", "purpose", "advice", "advised_by", "lookahead", "goal_left_s", "unless_met"}
    | {"interchangeable", "coming", "kept"}
)
_Limits = dict[str, Annotated[float, msgspec.Meta(gt=0, lt=LIMIT_MAX)]]
_Priority = Annotated[int, msgspec.Meta(ge=-PRIORITY_MAX, le=PRIORITY_MAX)]


class SubmitRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Asks for a session; see `read_contract`."""

    kind: str
    contract: Fields


class AmendRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Changes limits [s] or priority of a pending session."""

    kind: str = "amend"
    session: SessionId
    limits: _Limits = {}
    priority: _Priority | None = None


class CancelRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Asks for the end of a session."""

    kind: str
    session: SessionId
    reason: str = ""


Request = SubmitRequest | AmendRequest | CancelRequest
REQUESTS: dict[str, type[Request]] = {"submit": SubmitRequest, "amend": AmendRequest, "cancel": CancelRequest}


def parse_form(text: str, source: str, line: int = 1) -> Located:
    """As `parse_yaml`, of at most `VALUES_MAX` values."""
    return parse_yaml(text, source, line, VALUES_MAX)


def read_contract(located: Located, id: str) -> Session:
    """The session that the `contract` of a form asks for; `id` is the heading or file name, which it may repeat.

    Raises DefinitionError with one problem per violation, each at file:line:column.
    """
    path, contract = ("contract",), located.data["contract"]
    if not isinstance(contract, dict):
        raise DefinitionError(located.problem("INVALID_VALUE", path, type(contract).__name__, "a mapping (Session)"))
    hint = "Delete the line: it belongs to the agent; by hand it serves no goal."
    foreign = [key for key in contract if key in _OF_AGENT and contract[key]]
    if foreign:
        raise DefinitionError([located.problem("NOT_PERMITTED", (*path, key), repr(key), hint=hint) for key in foreign])
    filled = {"seed": 0, "parameters": {}} | {key: value for key, value in contract.items() if key not in _OF_AGENT}
    filled |= {"id": filled.get("id", id), "goal": BY_HAND, "node": ""}
    if isinstance(scene := filled.get("scene"), dict):
        filled["scene"] = {"seed": 0, "episode": id, **scene}
    whole = Located({"contract": filled}, located.source, located.marks)
    session = convert_located(Session, whole, path)
    read_amendment(located, session.id, filled)
    problems = [
        located.problem("INVALID_VALUE", (*path, key), repr(contract.get(key, id)), expected)
        for key, holds, expected in (
            ("id", session.id == id, f"{id!r}, as the heading or the file is called"),
            ("id", _ID.fullmatch(id) and id != JOURNAL_ID, "letters, digits, '.', '_', '-', at most 120"),
            ("accept", session.accept, "at least one predicate"),
            ("strategy", session.strategy.speed > 0, "a speed greater than 0"),
        )
        if not holds
    ]
    problems += _check_predicates(located, session)
    raise_any(problems)
    return session


def read_amendment(located: Located, id: SessionId, values: Mapping[str, object]) -> AmendRequest:
    """The `limits` and `priority` among the values of a `contract`, which stand at its places in `located`.

    Raises DefinitionError with one problem per violation, each at file:line:column.
    """
    wanted = {key: values[key] for key in ("limits", "priority") if key in values}
    placed = Located({"contract": {"session": id, **wanted}}, located.source, located.marks)
    return convert_located(AmendRequest, placed, ("contract",))


def plan(request: Request, located: Located, name: str, sessions: Mapping[SessionId, SessionStatus]) -> Entry | None:
    """The record that a request becomes, None when it stands already; `name` is the default id of a new session.

    Raises DefinitionError for an invalid contract.
    """
    match request:
        case SubmitRequest():
            contract = read_contract(located, str(request.contract.get("id") or name))
            status = sessions.get(contract.id)
            if status is not None and _to_plain(status.contract) == _to_plain(contract):
                return None
            return Entry(contract.id, "submit", msgspec.to_builtins(contract, str_keys=True))
        case AmendRequest():
            amendment, status = (
                Amendment(limits=request.limits, priority=request.priority),
                sessions.get(request.session),
            )
            is_known = request.limits.keys() <= set(Limits.__struct_fields__)  # else the journal refuses it
            if status is not None and is_known and apply_amendment(status.contract, amendment) == status.contract:
                return None
            return Entry(request.session, "amend", msgspec.to_builtins(amendment))
        case CancelRequest():
            state = sessions[request.session].state if request.session in sessions else ""
            if state in {SessionState.CANCELLING, SessionState.CANCELLED}:
                return None
            body = {"reason": request.reason or "requested by hand"}
            return Entry(request.session, (state and find_cancel(state)) or "cancel", body)


def refuse_conflict(request: AmendRequest, now: Session, shown: Session) -> None:
    """Raise ValueError when what a person changes has changed since it was shown."""
    wanted: list[tuple[str, msgspec.Struct, msgspec.Struct]]
    wanted = [(name, now.limits, shown.limits) for name in request.limits]
    wanted += [("priority", now, shown)] if request.priority is not None else []
    for name, present, past in wanted:
        if (value := getattr(present, name, None)) != (before := getattr(past, name, None)):
            raise ValueError(f"{name} was {before} where you began and is {value} by now; change the present file")


def _to_plain(contract: Session) -> object:
    """As the journal would give it back."""
    return msgspec.json.decode(msgspec.json.encode(contract))


def _check_predicates(located: Located, session: Session) -> list[Problem]:
    problems = []
    for key in ("accept", "requires", "hold"):
        for index, text in enumerate(getattr(session, key)):
            try:
                parse(text)
            except PredicateSyntaxError as error:
                path = ("contract", key, index)
                problems.append(located.problem("SYNTAX", path, repr(text), hint=str(error)))
    return problems
