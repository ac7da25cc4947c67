"""What becomes of an edit: a record, nothing because it is recorded already, or a refusal with its reason."""

from collections.abc import Mapping
from dataclasses import dataclass

import msgspec

from phyagentos.protocol.sessions.lifecycle import FINAL_STATES, SessionState, find_cancel
from phyagentos.protocol.sessions.session import Amendment, Session, SessionId, SessionStatus, apply_amendment
from phyagentos.store.admission import Entry

CANCELS = frozenset({"cancel", "cancelled", "canceled"})


@dataclass(frozen=True, slots=True, kw_only=True)
class Accepted:
    """An edit that may be recorded; `line` counts from 1, `summary` is for the log."""

    entry: Entry
    line: int
    summary: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Refused:
    """An edit that was not taken.

    Attributes:
        line: Of the edited file, counted from 1.
        text: As it was written, word for word.
    """

    line: int
    about: str
    reason: str
    possible: str
    text: str


class Impossible(Exception):
    """A request that cannot be done; `possible` is what could be done instead."""

    def __init__(self, reason: str, possible: str) -> None:
        self.reason, self.possible = reason, possible
        super().__init__(f"{reason}. Possible: {possible}")


def plan_submit(contract: Session, sessions: Mapping[SessionId, SessionStatus]) -> Entry | None:
    """The record that submits a session; None when it was submitted so before; Impossible when its id is taken."""
    status = sessions.get(contract.id)
    if status is None:
        return Entry(contract.id, "submit", msgspec.to_builtins(contract, str_keys=True))
    amended = Amendment(limits=msgspec.structs.asdict(contract.limits), priority=contract.priority)
    if _to_plain(apply_amendment(status.contract, amended)) != _to_plain(contract):
        raise Impossible(f"another session is called {contract.id}", "choose an id that is free")
    if _to_plain(status.contract) != _to_plain(contract):
        raise Impossible(
            f"session {contract.id} was submitted before, with other limits or another priority",
            "change them in its section of the present file",
        )
    return None


def plan_cancel(id: SessionId, reason: str, sessions: Mapping[SessionId, SessionStatus]) -> Entry | None:
    """The record that asks for an end, None when that was asked before; Impossible for an unknown or ended session."""
    status = _get(id, sessions)
    if status.state in {SessionState.CANCELLING, SessionState.CANCELLED}:
        return None
    if status.state in FINAL_STATES:
        raise Impossible(f"session {id} is {status.state}, which is final", "nothing; submit a new session")
    trigger = find_cancel(status.state)
    if trigger is None:
        raise Impossible(f"session {id} is {status.state}", "wait until its target was observed, then cancel")
    return Entry(id, trigger, {"reason": reason or "asked for by hand"})


def plan_amend(id: SessionId, amendment: Amendment, sessions: Mapping[SessionId, SessionStatus]) -> Entry | None:
    """The record that changes limits or priority, None when they are so; Impossible for unknown or claimed sessions."""
    status = _get(id, sessions)
    if apply_amendment(status.contract, amendment) == status.contract:
        return None
    if status.state != SessionState.PENDING:
        what = "it is final" if status.state in FINAL_STATES else "cancel it ('state: cancelled')"
        raise Impossible(
            f"session {id} is {status.state}; limits and priority change only while it is pending",
            f"{what}, and submit a new one",
        )
    return Entry(id, "amend", msgspec.to_builtins(amendment))


def _get(id: SessionId, sessions: Mapping[SessionId, SessionStatus]) -> SessionStatus:
    if id not in sessions:
        raise Impossible(f"there is no session {id}", "a session of SESSIONS.md")
    return sessions[id]


def _to_plain(contract: Session) -> object:
    """As the journal would give it back."""
    return msgspec.json.decode(msgspec.json.encode(contract))
