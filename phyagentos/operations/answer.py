"""What people say of sessions and goals: answers to the questions of their criteria, and that a verdict is contested.

Neither changes a verdict. After one, an answer is judged on beside it; a contest is a judgement of its own beside it.
"""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import msgspec

from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.operations.verify import Judged, verify
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.sessions.answers import Answer, find_open, keep_answer
from phyagentos.protocol.sessions.evidence import PICTURE_AFTER, PICTURE_BEFORE
from phyagentos.protocol.sessions.lifecycle import REVIEW, SessionState, Side, list_triggers
from phyagentos.protocol.sessions.session import Ended, GoalId, SessionId
from phyagentos.protocol.sessions.tasks import NodeState
from phyagentos.protocol.sessions.verdicts import PERSON, Attempt, Verdict
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.truth import Truth
from phyagentos.store.journal import Entry, Journal
from phyagentos.store.ledger import Ledger
from phyagentos.store.subjects import get_session
from phyagentos.wording import format_time

_REPLACED = {SessionState.REPLANNED, SessionState.CANCELLED}
_DONE = {NodeState.DONE, NodeState.SKIPPED, NodeState.RESCUED}
_SAYS = {"yes": Truth.TRUE, "y": Truth.TRUE, "no": Truth.FALSE, "n": Truth.FALSE}


class OpenQuestion(msgspec.Struct, frozen=True, kw_only=True):
    """A question that waits for a person.

    Attributes:
        subject: The session or goal that it decides.
        is_decided: Whether that has its verdict, beside which an answer is judged.
        pictures: Of the world before and after; of a goal, of its last session.
    """

    subject: str
    question: str
    is_decided: bool = False
    pictures: tuple[str, ...] = ()


class Answered(msgspec.Struct, frozen=True, kw_only=True):
    """An answer, and the judgement that it made beside the verdict that there was."""

    subject: str
    answer: Answer
    judged: Judged | None = None


def iter_open(workspace: Workspace, ledger: Ledger, about: GoalId | None = None) -> Iterator[OpenQuestion]:
    """Questions about sessions that ran to their end and were not replaced, and about goals without open sessions."""
    for status in ledger.sessions.values():
        id, is_whole = status.contract.id, status.execution is not None and status.execution.ended is Ended.COMPLETED
        if is_whole and status.state not in _REPLACED and about in {None, status.contract.goal}:
            for each in find_open(workspace.evidence_of(id), status.contract.accept):
                pictures, is_decided = _find_pictures(workspace, id), status.decision is not None
                yield OpenQuestion(subject=id, question=each, is_decided=is_decided, pictures=pictures)
    for goal in ledger.goals.values():
        is_over = bool(goal.verdict) or all(node.state in _DONE for node in goal.nodes.values())
        if is_over and not goal.is_cancelled and about in {None, goal.id}:
            for each in find_open(workspace.answers_of(goal.id), goal.accept):
                last = next((id for node in reversed(goal.nodes.values()) for id in node.sessions[-1:]), None)
                pictures = _find_pictures(workspace, last) if last is not None else ()
                yield OpenQuestion(subject=goal.id, question=each, is_decided=bool(goal.verdict), pictures=pictures)


def read_says(text: str) -> Truth | None:
    """`yes` or `no` as the value of a criterion; None of any other word."""
    return _SAYS.get(text.strip().lower())


def record(workspace: Workspace, subject: str, question: str, truth: Truth, by: str) -> Answer:
    """Keep an answer in the evidence; raises DefinitionError `WOULD_OVERWRITE` where there is one."""
    answer = Answer(question=question, truth=truth, by=by, at=SystemClock().wall_iso())
    is_goal = (workspace.goal_file_of(GoalId(subject))).is_file()
    folder = workspace.answers_of(GoalId(subject)) if is_goal else workspace.evidence_of(SessionId(subject))
    if not keep_answer(folder, answer):
        hint = f"An answer stays; `paos contest {subject} --because TEXT` says that the verdict is wrong."
        raise DefinitionError.of("WOULD_OVERWRITE", subject, f"an answer to {question!r}", "an open question", hint)
    return answer


def answer(root: Path, name: str, says: str, *, by: str, question: int = 0) -> Answered:
    """Answer a question about a session or goal; of several the `question`th, from 1.

    Of a session that has its verdict, a judgement with the answer is added beside it. Raises DefinitionError
    `UNKNOWN_NAME`, `INVALID_VALUE`, `WOULD_OVERWRITE`.
    """
    workspace, ledger = Workspace.open(root), read_ledger(root)
    subject = name if GoalId(name) in ledger.goals else get_session(name, ledger.sessions)
    if (truth := read_says(says)) is None:
        raise DefinitionError.of("INVALID_VALUE", "answer", repr(says), "yes or no")
    waiting = list(iter_open(workspace, ledger))
    if not (found := [each.question for each in waiting if each.subject == subject]):
        expected = f"one that waits: {', '.join(dict.fromkeys(each.subject for each in waiting)) or 'none does'}"
        raise DefinitionError.of("INVALID_VALUE", subject, "no question that waits for an answer", expected)
    if (not question and len(found) > 1) or question > len(found):
        several = "; ".join(f"{number} {each}" for number, each in enumerate(found, 1))
        raise DefinitionError.of("INVALID_VALUE", "--question", str(question or "none"), several)
    kept = record(workspace, subject, found[max(question, 1) - 1], truth, by)
    status = ledger.sessions.get(SessionId(subject))
    is_over = status is not None and REVIEW in list_triggers(status.state)
    judged = verify(root, subject, by=f"paos answer, {by}") if is_over else None
    return Answered(subject=subject, answer=kept, judged=judged)


def contest(root: Path, name: str, *, because: str, by: str) -> Judged:
    """Say that the verdict on a session is wrong, as a judgement of a person beside it: the opposite, and why.

    Raises DefinitionError `UNKNOWN_NAME`, `NOT_EXECUTED`.
    """
    workspace, sessions = Workspace.open(root), read_ledger(root, name).sessions
    status = sessions[get_session(name, sessions)]
    id, decided = status.contract.id, status.decision
    if decided is None or REVIEW not in list_triggers(status.state):
        raise DefinitionError.of("NOT_EXECUTED", f"session {id}", f"state {status.state}", "a session with its verdict")
    says, clock = Verdict.SUCCESS if decided.verdict.is_miss else Verdict.FAILURE, SystemClock()
    attempt = Attempt(
        verdict=says,
        criteria=(),
        reason=f"{by} at {format_time(clock.wall_iso())}: {because}",
        sensing="none",
        verifier=PERSON,
        judges=(by,),
        is_review=True,
    )
    with closing(Journal(workspace.root, side=Side.AGENT, by=f"paos contest, {by}", clock=clock)) as journal:
        journal.commit([Entry(id, REVIEW, {"attempt": attempt})])
    return Judged(session=id, judgement=attempt, number=len(status.attempts) + 1, verdict=decided.verdict)


def _find_pictures(workspace: Workspace, session: SessionId) -> tuple[str, ...]:
    files = (workspace.evidence_of(session) / name for name in (PICTURE_BEFORE, PICTURE_AFTER))
    return tuple(str(each) for each in files if each.is_file())
