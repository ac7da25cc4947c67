"""`paos verify`: another judgement of a session that has its verdict, by judges of one's choice."""

from collections.abc import Iterable
from contextlib import closing
from typing import TYPE_CHECKING, Annotated

import typer

from phyagentos.cli.explaining import Space
from phyagentos.cli.outcome import ExitCode, print_json, print_result
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import SessionStatus
from phyagentos.protocol.sessions.verdicts import Criterion, Verdict
from phyagentos.protocol.settings.verification import JudgeName
from phyagentos.protocol.settings.verification_mode import VerificationMode
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.journal import Journal
from phyagentos.store.subjects import get_session

if TYPE_CHECKING:
    from phyagentos.agent.judging.verifier import SessionVerifier


def verify(
    session: Annotated[str, typer.Argument(help="Id of the session.")],
    workspace: Space,
    with_: Annotated[
        str | None,
        typer.Option(
            "--with",
            help=f"Judges, comma-separated: {', '.join(JudgeName)}, or installed ones. "
            "Those of the settings if left out.",
        ),
    ] = None,
    mode: Annotated[VerificationMode, typer.Option(help="What the judgement is for.")] = VerificationMode.ENFORCE,
    from_frames: Annotated[
        bool,
        typer.Option("--from-frames", help="Perceive the stored camera frames again, judge, compare; records nothing."),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="The judgement as JSON on stdout.")] = False,
) -> int:
    """Add a judgement to a session that has its verdict; erases none and changes no state."""
    from phyagentos.agent.judging.review import review_session
    from phyagentos.assembly.verification import build_verifier
    from phyagentos.cli.history import read_ledger

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
    if as_json:
        print_json(attempt)
    else:
        print_result(f"{status.contract.id}: {attempt.verdict}  {attempt.reason}")
        _print_criteria(attempt.criteria)
        decided = status.decision.verdict if status.decision is not None else "none"
        print_result(f"  added as judgement {len(status.attempts) + 1}; the verdict stays {decided}")
    return int(ExitCode.GOAL_MET if attempt.verdict is Verdict.SUCCESS else ExitCode.GOAL_NOT_MET)


def _verify_from_frames(
    workspace: Workspace, status: SessionStatus, verifier: "SessionVerifier", *, as_json: bool
) -> int:
    """Exit code 0 where what is perceived and judged again is equal to what was recorded."""
    from phyagentos.agent.judging.from_frames import judge_again
    from phyagentos.agent.judging.goal_judgement import Evidence
    from phyagentos.assembly.from_frames import perceive_again

    seen = perceive_again(workspace, status)
    again = judge_again(Evidence(workspace.root).read(status), seen, verifier, status.decision)
    if as_json:
        print_json(again)
    else:
        equal = "equal to what was recorded" if not again.differences else "not what was recorded"
        print_result(f"{again.session}: {len(again.criteria)} criteria from {again.looks} looks, {equal}")
        _print_criteria(again.criteria)
        for difference in again.differences:
            print_result(f"  differs: {difference}")
    return int(ExitCode.GOAL_NOT_MET if again.differences else ExitCode.GOAL_MET)


def _print_criteria(criteria: Iterable[Criterion]) -> None:
    for criterion in criteria:
        print_result(f"  {criterion.truth}: {criterion.kind} {criterion.text}: {criterion.because}")
