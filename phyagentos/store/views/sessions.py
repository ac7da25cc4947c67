"""SESSIONS.md: every live session and the latest finished ones, for people first and as one YAML block each.

The same text is an input: what a person changes in it is merged by `edits`.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import PurePosixPath

import msgspec

from phyagentos.protocol.documents.body_codec import render_yaml
from phyagentos.protocol.documents.document import FrontMatter
from phyagentos.protocol.documents.markdown import (
    flatten,
    format_value,
    render_front,
    render_link,
    render_row,
    render_table,
)
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.lifecycle import FINAL_STATES, SessionState, render_mermaid
from phyagentos.protocol.sessions.session import Ended, SessionId, SessionStatus
from phyagentos.protocol.sessions.verdicts import Attempt, Criterion
from phyagentos.protocol.world.idealisations import format_idealisations
from phyagentos.protocol.world.truth import Truth
from phyagentos.store.ledger import Ledger
from phyagentos.wording import count

FINISHED_SHOWN = 50
END_MARK = "<!-- end of view -->\n"
NOTE_MARK = "> **Refused:** "  # begins each line about a refused edit

_COLUMNS = ("session", "state", "verdict", "execution", "skill", "target", "objective")
_MARKS = {Truth.TRUE: "yes", Truth.FALSE: "**no**", Truth.UNKNOWN: "*unknown*"}
_INTRODUCTION = """# Sessions

A view of the journal in `sessions/`, which is the truth. Three records never stand for each other: `execution` (did the
instructions run), the evidence folder (what was observed before and after), `attempts` (was the objective met). Each
section shows it in words first, then as data.

**This file can be edited**, with `paos edit` or with any editor. Change `limits` or `priority` of a pending session;
write `state: cancelled` into a block, and a line `reason: ...` if you like, to end a session; append a section
`## <new id>` with a YAML block `contract: ...` to submit one. Everything else is refused and kept, word for word, in
`SESSIONS.rejected.md`. A section that you delete changes nothing: it is back with the next rendering.

```mermaid
"""


@dataclass(frozen=True, slots=True)
class Page:
    """What one rendering shows: of `total` sessions some, in order, and a note for each edit refused lately."""

    seq: int
    shown: Sequence[SessionStatus]
    total: int
    notes: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class Rendered:
    """A session as a row of the overview and a section, kept until its status changes."""

    status: SessionStatus
    row: str
    block: str


Cache = dict[SessionId, Rendered]


def build_page(ledger: Ledger, notes: Sequence[str] = ()) -> Page:
    """What SESSIONS.md shows now: live sessions in the order of submission, then the last submitted of the finished."""
    finished = (status for status in reversed(ledger.sessions.values()) if status.state in FINAL_STATES)
    shown = [*ledger.live_sessions(), *islice(finished, FINISHED_SHOWN)]
    return Page(ledger.seq, shown, ledger.session_count, notes)


def render_page(page: Page, cache: Cache | None = None) -> str:
    """SESSIONS.md; texts of an earlier rendering that did not change come from `cache`."""
    known = cache if cache is not None else {}
    texts = []
    for status in page.shown:
        text = known.get(status.contract.id)
        if text is None or text.status is not status:
            text = known[status.contract.id] = Rendered(status, _render_row(status), render_session(status))
        texts.append(text)
    if len(known) > 2 * len(texts) + FINISHED_SHOWN:  # forget what is shown no more
        shown = {text.status.contract.id for text in texts}
        for id in [id for id in known if id not in shown]:
            del known[id]
    front = render_front(FrontMatter(phy="sessions/1", view=page.seq))
    parts = [front, *(f"{NOTE_MARK}{flatten(note)}\n" for note in page.notes)]
    parts += ["\n"] if page.notes else []
    parts += [_INTRODUCTION, render_mermaid(), "```\n\n", *_render_overview(texts, page.total)]
    return "".join([*parts, *(text.block for text in texts), END_MARK])


def render_session(status: SessionStatus) -> str:
    """One `## <id>` section."""
    folder = status.execution.evidence if status.execution is not None else ""
    return (
        f"## {status.contract.id}\n\n{_format(status)}\n\n"
        f"{''.join(_render_attempt(number, each, folder) for number, each in enumerate(status.attempts, 1))}"
        f"```yaml\n{render_yaml(build_data(status))}```\n\n"
    )


def build_data(status: SessionStatus) -> Fields:
    """The YAML block of a session as plain data: its status; while it is pending with every field that may change."""
    data: Fields = msgspec.to_builtins(status, str_keys=True)
    if status.state == SessionState.PENDING:
        contract = status.contract
        data["contract"] |= {"limits": msgspec.structs.asdict(contract.limits), "priority": contract.priority}
    return data


def describe_execution(status: SessionStatus) -> str:
    """How the execution ended, in one sentence; empty before."""
    execution = status.execution
    if execution is None:
        return ""
    how = execution.ended.value.replace("_", " ")
    if execution.ended is not Ended.COMPLETED and execution.leaf:
        how += f" at `{execution.leaf}`"
    if execution.code:
        how += f" ({execution.code})"
    if execution.message:
        how += f": {execution.message.rstrip('.')}"
    guard = f", {count(execution.interventions, 'safety intervention')}" if execution.interventions else ""
    return f"{how}; {execution.sim_time_s:.2f} s simulated, {count(execution.ticks, 'command')}{guard}."


def describe_attempt(attempt: Attempt) -> str:
    """The verdict and its reason, in one sentence."""
    cause = f" ({attempt.cause})" if attempt.cause else ""
    reason = f": {attempt.reason.rstrip('.')}" if attempt.reason else ""
    return f"{attempt.verdict}{cause}{reason}."


def render_criteria(criteria: Sequence[Criterion], folder: str = "") -> str:
    """Judged criteria, one row each; empty without any. Evidence links into the bundle `folder`, if given."""
    if not criteria:
        return ""
    rows = (
        (
            f"`{each.text}`",
            each.kind,
            _MARKS[each.truth],
            each.because,
            ", ".join(f"{name} = {format_value(value)}" for name, value in each.measured.items()),
            render_link(str(PurePosixPath(folder) / each.evidence), each.evidence)
            if folder and each.evidence
            else each.evidence,
        )
        for each in criteria
    )
    return render_table(("criterion", "kind", "holds", "because", "measured", "evidence"), rows) + "\n"


def _format(status: SessionStatus) -> str:
    contract = status.contract
    arguments = ", ".join(f"{name} = {value}" for name, value in contract.parameters.items())
    lines = [
        f"**Asked:** {contract.objective} (`{contract.skill}` on `{contract.target}`; {arguments or 'no arguments'})"
        + (f", by {status.asked_by}" if status.asked_by else "")
    ]
    if contract.parent is not None:
        differently = f"; differently: {contract.strategy}" if contract.strategy else ""
        lines.append(f"**Revises:** `{contract.parent}`{differently}")
    lines.append(f"**State:** {status.state}, since {status.updated_at}")
    if status.claimed_by:
        lines.append(f"**Done by:** {status.claimed_by}, epoch {status.epoch}")
    if status.execution is not None:
        lines.append(f"**Execution:** {describe_execution(status)}")
        if status.execution.evidence:
            lines.append(f"**Evidence:** [{status.execution.evidence}]({status.execution.evidence})")
    if status.reason:
        lines.append(f"**Reason:** {status.reason}")
    return "\n".join(f"- {flatten(line)}" for line in lines)  # whatever an objective holds


def _render_attempt(number: int, attempt: Attempt, folder: str) -> str:
    idealised = format_idealisations(attempt.idealisations)
    told = f"Sensing: {attempt.sensing}." + (f" Idealised: {idealised}." if idealised else "")
    verdict = flatten(f"{describe_attempt(attempt)} {told}")
    return f"**Verdict {number}:** {verdict}\n\n" + render_criteria(attempt.criteria, folder)


def _render_row(status: SessionStatus) -> str:
    contract = status.contract
    verdict = status.decision.verdict.value if status.decision is not None else ""
    ended = status.execution.ended.value if status.execution is not None else ""
    return render_row((contract.id, status.state, verdict, ended, contract.skill, contract.target, contract.objective))


def _render_overview(texts: Sequence[Rendered], total: int) -> Iterable[str]:
    if not texts:
        return ["No session has been submitted yet.\n\n"]
    hidden = f"\n{total - len(texts)} older sessions are in the journal.\n" if total > len(texts) else ""
    return [render_table(_COLUMNS, ()), *(text.row for text in texts), hidden, "\n"]
