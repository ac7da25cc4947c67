"""What a person may request: a contract, an amendment, an end; one form for SESSIONS.md and for files of the inbox.

A session by hand serves no goal, so it has no node and no parent.
"""

import re
from typing import Annotated, Any, Literal

import pydantic

from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.documents.schema import Address, Authored, Located, parse_yaml, validate
from phyagentos.protocol.predicates.language import PredicateSyntaxError, parse
from phyagentos.protocol.sessions.session import (
    PRIORITY_MAX,
    Amendment,
    GoalId,
    Limits,
    ResetPolicy,
    Scene,
    Session,
    SessionId,
)
from phyagentos.protocol.sessions.strategy import OWN_WAY, Strategy
from phyagentos.store.records import JOURNAL_ID

BY_HAND = GoalId("")  # goal of a session that serves none
VALUES_MAX = 10_000  # of one request
_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,119}")
_OF_AGENT = ("goal", "node", "parent", "attempt")
_Seconds = Annotated[float, pydantic.Field(gt=0, strict=True)]
_Whole = Annotated[int, pydantic.Field(strict=True, ge=-(2**63), lt=2**63)]
_Priority = Annotated[int, pydantic.Field(strict=True, ge=-PRIORITY_MAX, le=PRIORITY_MAX)]
_Word = Annotated[str, pydantic.Field(min_length=1)]


class LimitsForm(Authored):
    """Limits [s] by name; see `Limits`."""

    timeout_s: _Seconds = Limits().timeout_s
    wall_timeout_s: _Seconds = Limits().wall_timeout_s
    queue_s: _Seconds = Limits().queue_s
    preflight_s: _Seconds = Limits().preflight_s
    heartbeat_s: _Seconds = Limits().heartbeat_s
    stall_s: _Seconds = Limits().stall_s
    think_s: _Seconds = Limits().think_s
    policy_s: _Seconds = Limits().policy_s


class SceneForm(Authored):
    """The world of a session; without an episode it begins with a fresh one."""

    name: _Word
    seed: _Whole = 0
    episode: _Word | None = None


class StrategyForm(Authored):
    """What is done differently; see `Strategy`."""

    avoid_grasps: tuple[_Word, ...] = ()
    avoid_sites: tuple[_Word, ...] = ()
    speed: Annotated[float, pydantic.Field(gt=0, strict=True)] = OWN_WAY.speed


class ContractForm(Authored):
    """A contract as a person writes it; see `Session`."""

    id: _Word | None = None
    objective: _Word
    skill: _Word
    target: _Word
    parameters: dict[str, Any] = {}
    accept: Annotated[tuple[str, ...], pydantic.Field(min_length=1)]
    scene: SceneForm
    seed: _Whole = 0
    requires: tuple[str, ...] = ()
    hold: tuple[str, ...] = ()
    limits: LimitsForm = LimitsForm()
    strategy: StrategyForm = StrategyForm()
    priority: _Priority = 0
    resources: tuple[_Word, ...] = ()
    reset_policy: ResetPolicy = ResetPolicy.ON_NEW_EPISODE


class SubmitRequest(Authored):
    """Asks for a session; the contract is a `ContractForm`."""

    kind: Literal["submit"]
    contract: dict[str, Any]


class AmendRequest(Authored):
    """Changes limits or priority of a pending session."""

    kind: Literal["amend"]
    session: _Word
    limits: dict[str, Any] = {}
    priority: _Priority | None = None


class CancelRequest(Authored):
    """Asks for the end of a session."""

    kind: Literal["cancel"]
    session: _Word
    reason: str = ""


Request = SubmitRequest | AmendRequest | CancelRequest
REQUESTS: dict[str, type[SubmitRequest] | type[AmendRequest] | type[CancelRequest]] = {
    "submit": SubmitRequest,
    "amend": AmendRequest,
    "cancel": CancelRequest,
}


def parse_form(text: str, source: str, line: int = 1) -> Located:
    """As `parse_yaml`, of at most `VALUES_MAX` values: it is read between two turns of who supervises."""
    return parse_yaml(text, source, line, VALUES_MAX)


def read_contract(located: Located, path: Address, id: str) -> Session:
    """The session that a form asks for; `id` is the heading or file name, which the form may repeat.

    Raises DefinitionError with one problem per violation, each at file:line:column.
    """
    owner = located.data
    for step in path:
        owner = owner[step] if isinstance(owner, dict) and step in owner else None
    hint = "Delete the line: it belongs to the agent; by hand it serves no goal."
    problems = [
        located.problem("NOT_BY_HAND", (*path, key), repr(key), hint=hint)
        for key in _OF_AGENT
        if isinstance(owner, dict) and owner.get(key)
    ]
    if problems:
        raise DefinitionError(problems)
    clean = {key: each for key, each in owner.items() if key not in _OF_AGENT} if isinstance(owner, dict) else owner
    form = validate(ContractForm, _replace(located, path, clean), path)
    problems = _check_id(located, path, form.id or id, id) + _check_predicates(located, path, form)
    if problems:
        raise DefinitionError(problems)
    return _to_session(form, SessionId(id))


def read_amendment(located: Located, path: Address, values: dict[str, Any], priority: int | None) -> Amendment:
    """The new limits (`values`, located at `path`) and priority; raises DefinitionError for an invalid limit."""
    validate(LimitsForm, _replace(located, path, values), path)
    return Amendment(limits={name: float(value) for name, value in values.items()}, priority=priority)


def _replace(located: Located, path: Address, value: Any) -> Located:
    """The same places, with another value at `path`."""
    data: Any = value
    for step in reversed(path):
        data = {step: data}
    return Located(data, located.source, located.marks)


def _check_id(located: Located, path: Address, found: str, id: str) -> list[Problem]:
    place = (*path, "id")
    if found != id:
        hint = "The heading, or the name of the file, and 'id' must agree; one of them may be left out."
        return [located.problem("NAME_MISMATCH", place, repr(found), repr(id), hint)]
    if _ID.fullmatch(id) is None or id == JOURNAL_ID:
        return [located.problem("INVALID_ID", place, repr(id), "letters, digits, '.', '_', '-', at most 120")]
    return []


def _check_predicates(located: Located, path: Address, form: ContractForm) -> list[Problem]:
    problems = []
    for key in ("accept", "requires", "hold"):
        for index, text in enumerate(getattr(form, key)):
            try:
                parse(text)
            except PredicateSyntaxError as error:
                problems.append(located.problem("PREDICATE_SYNTAX", (*path, key, index), repr(text), hint=str(error)))
    return problems


def _to_session(form: ContractForm, id: SessionId) -> Session:
    named_alike = form.model_dump(exclude={"id", "scene", "limits", "strategy"})
    return Session(
        id=id,
        goal=BY_HAND,
        node="",
        scene=Scene(name=form.scene.name, seed=form.scene.seed, episode=form.scene.episode or id),
        limits=Limits(**form.limits.model_dump()),
        strategy=Strategy(**form.strategy.model_dump()),
        **named_alike,
    )
