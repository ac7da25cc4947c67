"""SESSIONS.md: every live session and the latest finished ones, for people first and as one YAML block each.

Upstream: the fold. Each block says what was asked, who did it, what was seen and why the verdict fell as it did.
"""

from collections.abc import Mapping, Sequence
from itertools import islice

from phyagentos.protocol.lifecycle import FINAL_STATES, render_mermaid
from phyagentos.protocol.markdown import render_criteria, render_table
from phyagentos.protocol.sessions import Ended, SessionId, SessionStatus
from phyagentos.protocol.store.bodies import render_yaml
from phyagentos.protocol.store.ledger import Ledger
from phyagentos.protocol.verdicts import Attempt

FINISHED_SHOWN = 50
END_MARK = "<!-- end of view -->\n"

_INTRODUCTION = """# Sessions

A view of the journal in `sessions/`, which is the truth. Three records never stand for each other: `execution` (did the
instructions run), the evidence folder (what was observed before and after), `attempts` (was the objective met). Each
section tells it in words first, then as data.

```mermaid
"""


def select_sessions(ledger: Ledger) -> list[SessionStatus]:
    """Live sessions in the order of submission, then the last submitted of the finished ones."""
    finished = (status for status in reversed(ledger.sessions.values()) if status.state in FINAL_STATES)
    return ledger.live_sessions() + list(islice(finished, FINISHED_SHOWN))


def render_sessions(ledger: Ledger, cache: dict[SessionId, tuple[SessionStatus, str]] | None = None) -> str:
    """SESSIONS.md.

    Args:
        ledger: The fold.
        cache: Blocks of an earlier rendering; what did not change is taken from there.
    """
    known = cache if cache is not None else {}
    shown = select_sessions(ledger)
    blocks = []
    for status in shown:
        id = status.contract.id
        before = known.get(id)
        if before is None or before[0] is not status:
            before = known[id] = (status, render_session(status))
        blocks.append(before[1])
    head = f"---\nview: {ledger.seq}\n---\n\n{_INTRODUCTION}{render_mermaid()}```\n\n"
    return head + _render_overview(shown, len(ledger.sessions)) + "".join(blocks) + END_MARK


def render_session(status: SessionStatus) -> str:
    """One `## <id>` section."""
    return (
        f"## {status.contract.id}\n\n{_tell(status)}\n\n"
        f"{''.join(_render_attempt(number, attempt) for number, attempt in enumerate(status.attempts, 1))}"
        f"```yaml\n{render_yaml(status)}```\n\n"
    )


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
    guard = f", {execution.interventions} safety interventions" if execution.interventions else ""
    return f"{how}; {execution.sim_time_s:.2f} s simulated, {execution.ticks} commands{guard}."


def describe_attempt(attempt: Attempt) -> str:
    """The verdict and its reason, in one sentence."""
    cause = f" ({attempt.cause})" if attempt.cause else ""
    reason = f": {attempt.reason.rstrip('.')}" if attempt.reason else ""
    return f"{attempt.verdict}{cause}{reason}."


def _tell(status: SessionStatus) -> str:
    contract = status.contract
    arguments = ", ".join(f"{name} = {value}" for name, value in contract.parameters.items())
    lines = [
        f"**Asked:** {contract.objective} (`{contract.skill}` on `{contract.target}`; {arguments or 'no arguments'})"
    ]
    if contract.parent is not None:
        lines.append(f"**Revises:** `{contract.parent}`{_tell_strategy(contract.strategy)}")
    lines.append(f"**State:** {status.state}, since {status.updated_at}")
    if status.claimed_by:
        lines.append(f"**Done by:** {status.claimed_by}, epoch {status.epoch}")
    if status.execution is not None:
        lines.append(f"**Execution:** {describe_execution(status)}")
        if status.execution.evidence:
            lines.append(f"**Evidence:** [{status.execution.evidence}]({status.execution.evidence})")
    if status.reason:
        lines.append(f"**Reason:** {status.reason}")
    return "\n".join(f"- {line}" for line in lines)


def _tell_strategy(strategy: Mapping[str, object]) -> str:
    return "; differently: " + ", ".join(f"{name} {value}" for name, value in strategy.items()) if strategy else ""


def _render_attempt(number: int, attempt: Attempt) -> str:
    return f"**Verdict {number}:** {describe_attempt(attempt)} Sensing: {attempt.sensing}.\n\n" + render_criteria(
        attempt.criteria
    )


def _render_overview(shown: Sequence[SessionStatus], total: int) -> str:
    if not shown:
        return "No session has been submitted yet.\n\n"
    rows = (
        (
            status.contract.id,
            status.state,
            status.attempts[-1].verdict.value if status.attempts else "",
            status.execution.ended.value if status.execution is not None else "",
            status.contract.skill,
            status.contract.target,
            status.contract.objective,
        )
        for status in shown
    )
    table = render_table(("session", "state", "verdict", "execution", "skill", "target", "objective"), rows)
    hidden = f"\n{total - len(shown)} older sessions are in the journal.\n" if total > len(shown) else ""
    return f"{table}{hidden}\n"
