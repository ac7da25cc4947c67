"""`paos verify`: another judgement of a session that has its verdict, by judges of one's choice."""

from contextlib import closing
from typing import Annotated

import typer

from phyagentos.agent.judging.goal_judgement import Evidence
from phyagentos.agent.judging.review import judge_again, review_session
from phyagentos.agent.judging.verifier import SessionVerifier
from phyagentos.assembly.verification import build_verifier
from phyagentos.cli.arguments import AsJson
from phyagentos.cli.explaining import Space
from phyagentos.cli.outcome import ExitCode, print_found
from phyagentos.clock import SystemClock
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import SessionStatus
from phyagentos.protocol.sessions.verdicts import Criterion, Verdict
from phyagentos.protocol.settings.verification import JudgeName
from phyagentos.protocol.settings.verification_mode import VerificationMode
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.journal import Journal
from phyagentos.store.subjects import get_session

_WITH_HELP = f"Judges, comma-separated: {', '.join(JudgeName)}, or installed ones; those of the settings if left out."
_FRAMES_HELP = "Perceive the stored camera frames again, judge, compare; records nothing."


def verify(
    session: Annotated[str, typer.Argument(help="Id of the session.")],
    workspace: Space,
    with_: Annotated[str | None, typer.Option("--with", help=_WITH_HELP)] = None,
    mode: Annotated[VerificationMode, typer.Option(help="What the judgement is for.")] = VerificationMode.ENFORCE,
    from_frames: Annotated[bool, typer.Option("--from-frames", help=_FRAMES_HELP)] = False,
    as_json: AsJson = False,
) -> int:
    """Add a judgement to a session that has its verdict; erases none and changes no state."""
    place, clock = Workspace.open(workspace), SystemClock()
    names = None if with_ is None else tuple(filter(None, map(str.strip, with_.split(",")))) or (with_,)
    verifier = build_verifier(place, clock, mode=mode, judges=names)
    sessions = read_ledger(place.root, session).sessions
    status = sessions[get_session(session, sessions)]
    if from_frames:
        return _verify_from_frames(place, status, verifier, as_json=as_json)
    with closing(Journal(place.root, side=Side.AGENT, by="paos verify", clock=clock)) as journal:
        own = status.contract
        lineage = [
            each for each in sessions.values() if (each.contract.goal, each.contract.node) == (own.goal, own.node)
        ]
        attempt = review_session(place, journal, status, verifier, lineage)
    decided = status.decision.verdict if status.decision is not None else "none"
    lines = [f"{status.contract.id}: {attempt.verdict}  {attempt.reason}", *map(_render, attempt.criteria)]
    lines.append(f"  added as judgement {len(status.attempts) + 1}; the verdict stays {decided}")
    print_found(attempt, "\n".join(lines), as_json=as_json)
    return ExitCode.GOAL_MET if attempt.verdict is Verdict.SUCCESS else ExitCode.GOAL_NOT_MET


def _verify_from_frames(
    workspace: Workspace, status: SessionStatus, verifier: SessionVerifier, *, as_json: bool
) -> int:
    """Exit code 0 where what is perceived and judged again is equal to what was recorded."""
    from phyagentos.assembly.rerun import perceive_again

    seen = perceive_again(workspace, status)
    again = judge_again(Evidence(workspace.root).read(status), seen, verifier, status.decision)
    equal = "equal to what was recorded" if not again.differences else "not what was recorded"
    lines = [f"{again.session}: {len(again.criteria)} criteria from {again.looks} looks, {equal}"]
    lines += [*map(_render, again.criteria), *(f"  differs: {difference}" for difference in again.differences)]
    print_found(again, "\n".join(lines), as_json=as_json)
    return ExitCode.GOAL_NOT_MET if again.differences else ExitCode.GOAL_MET


def _render(criterion: Criterion) -> str:
    return f"  {criterion.truth}: {criterion.kind} {criterion.text}: {criterion.because}"
