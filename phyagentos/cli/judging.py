"""Sessions once more: `verify` and `judge` judge, people `answer` and `contest`; `rerun` carries one out again."""

import getpass
from pathlib import Path
from typing import Annotated

import typer

from phyagentos.agent.judging.review import JudgedAgain
from phyagentos.assembly.project import admit_python
from phyagentos.cli.arguments import TrustPython, choose_newest
from phyagentos.cli.explaining import Id, Space
from phyagentos.cli.outcome import ExitCode, print_note
from phyagentos.cli.reply import Reply
from phyagentos.errors import DefinitionError
from phyagentos.operations import answer as people
from phyagentos.operations import rerun as reruns
from phyagentos.operations import verify as verification
from phyagentos.operations.answer import Answered
from phyagentos.operations.rerun import Rerun
from phyagentos.operations.verify import Judged
from phyagentos.operations.verify_bag import BagVerdict, verify_bag
from phyagentos.protocol.sessions.verdicts import Criterion, Verdict
from phyagentos.protocol.settings.verification import JudgeName
from phyagentos.protocol.settings.verification_mode import VerificationMode
from phyagentos.protocol.world.truth import Truth
from phyagentos.wording import count

_WITH_HELP = f"Judges, comma-separated: {', '.join(JudgeName)}, or installed ones; those of the settings if left out."
_BAG_HELP = "Judge a recorded bag of ROS 2 instead, a folder or an MCAP file, of any robot."
_TO_HELP = "Where looks, pictures and the verdict on a bag are written; BAG_verdict without."
_IN = typer.Option("--workspace", "-w", show_default="the newest", help="Its folder.")
By = Annotated[str, typer.Option("--by", help="Who says so.", show_default="the user of this shell")]
_FRAMES_HELP = "Perceive the stored camera frames again, judge, compare; records nothing."


def verify(
    session: Annotated[str, typer.Argument(help="Id of the session; none with --bag.", show_default=False)] = "",
    workspace: Annotated[Path | None, _IN] = None,
    with_: Annotated[str | None, typer.Option("--with", help=_WITH_HELP)] = None,
    mode: Annotated[VerificationMode, typer.Option(help="What the judgement is for.")] = VerificationMode.ENFORCE,
    from_frames: Annotated[bool, typer.Option("--from-frames", help=_FRAMES_HELP)] = False,
    bag: Annotated[Path | None, typer.Option("--bag", help=_BAG_HELP)] = None,
    scene: Annotated[str, typer.Option(help="Of the bag: the scene whose objects it shows.")] = "",
    accept: Annotated[list[str] | None, typer.Option("--accept", help="A criterion on the bag; repeatable.")] = None,
    robot: Annotated[str, typer.Option(help="Of the bag; by its joints without.")] = "",
    settings: Annotated[Path | None, typer.Option(help="YAML: topics, frames and clocks of the bag.")] = None,
    to: Annotated[Path | None, typer.Option("--to", metavar="DIR", help=_TO_HELP)] = None,
) -> Reply[Judged | JudgedAgain | BagVerdict]:
    """Add a judgement to a session that has its verdict; erases none and changes no state. Or judge a bag of ROS 2."""
    if bag is not None:
        if session or from_frames or with_ is not None or workspace is not None:
            expected = "a bag, or a session of a workspace"
            raise DefinitionError.of("INVALID_VALUE", "--bag", "options of a session besides", expected)
        evidence = to or Path(f"{bag.name}_verdict")
        return _show_bag(verify_bag(bag, scene, accept or (), evidence, robot=robot, settings=settings))
    if scene or accept or robot or settings or to:
        raise DefinitionError.of("MISSING_VALUE", "--bag", "none, but options of one", "the folder of a bag")
    if not session:
        raise DefinitionError.of("MISSING_VALUE", "paos verify", "no session", "the id of one, or --bag")
    workspace = workspace or choose_newest()
    names = None if with_ is None else tuple(filter(None, map(str.strip, with_.split(",")))) or (with_,)
    if from_frames:
        return _show_again(verification.verify_from_frames(workspace, session, judges=names, mode=mode))
    judged = verification.verify(workspace, session, judges=names, mode=mode)
    judgement = judged.judgement
    lines = [f"{judged.session}: {judgement.verdict}  {judgement.reason}", *map(_render, judgement.criteria)]
    lines.append(f"  added as judgement {judged.number}; the verdict stays {judged.verdict or 'none'}")
    is_met = judgement.verdict is Verdict.SUCCESS
    return Reply(judged, "\n".join(lines), code=ExitCode.GOAL_MET if is_met else ExitCode.GOAL_NOT_MET)


def answer(
    subject: Annotated[str, typer.Argument(metavar="SESSION|GOAL", help="What the question is about.")],
    says: Annotated[str, typer.Argument(metavar="yes|no")],
    workspace: Space,
    by: By = "",
    question: Annotated[int, typer.Option(min=0, help="Which, where several wait; from 1.")] = 0,
) -> Reply[Answered]:
    """Answer a question that a criterion asks of a person (`human:`); it is kept as evidence, with your name."""
    found = people.answer(workspace, subject, says, by=by or getpass.getuser(), question=question)
    lines = [f"{found.subject}: {found.answer.question} {found.answer}"]
    if (judged := found.judged) is not None:
        lines.append(
            f"  added as judgement {judged.number}: {judged.judgement.verdict}; the verdict stays {judged.verdict}"
        )
    return Reply(found, "\n".join(lines))


def contest(
    session: Id,
    workspace: Space,
    because: Annotated[str, typer.Option("--because", help="What is wrong about it; it is recorded.")],
    by: By = "",
) -> Reply[Judged]:
    """Say that the verdict on a session is wrong: your judgement stands beside it, and never over it."""
    found = people.contest(workspace, session, because=because, by=by or getpass.getuser())
    text = f"{found.session}: contested as judgement {found.number}: {found.judgement.verdict}"
    return Reply(found, f"{text}\n  the verdict stays {found.verdict}")


def judge(
    workspace: Annotated[Path, typer.Argument(help="Folder of the run.")] = Path(),
) -> Reply[tuple[Judged, ...]]:
    """Judge the executed sessions without a goal, which no agent looks at."""
    found = verification.judge(workspace)
    text = "\n".join(f"{each.session}: {each.judgement.verdict}  {each.judgement.reason}" for each in found)
    notes = [] if found else ["no session by hand waits for a verdict"]
    is_missed = any(each.judgement.verdict is not Verdict.SUCCESS for each in found)
    return Reply(found, text, notes, ExitCode.GOAL_NOT_MET if is_missed else ExitCode.GOAL_MET)


def rerun(session: Id, workspace: Space, trust_python: TrustPython = False) -> Reply[Rerun]:
    """Run a session once more from its own documents and compare the bits of the terminal state."""
    admit_python(workspace, is_trusted=trust_python, announce=print_note)
    found = reruns.rerun(workspace, session)
    text = f"{found.session}: identical, bit for bit ({found.execution.ticks} commands)"
    if found.differences:
        text = "\n".join([f"{found.session} came out differently:", *found.differences])
    code = ExitCode.GOAL_NOT_MET if found.differences else ExitCode.GOAL_MET
    return Reply(found, text, [f"second bundle in {found.workspace}"], code)


def _show_again(found: JudgedAgain) -> Reply[JudgedAgain]:
    """Exit code 0 where what is perceived and judged again is equal to what was recorded."""
    equal = "equal to what was recorded" if not found.differences else "not what was recorded"
    criteria = count(len(found.criteria), "criterion", "criteria")
    lines = [f"{found.session}: {criteria} from {count(found.looks, 'look')}, {equal}"]
    lines += [*map(_render, found.criteria), *(f"  differs: {difference}" for difference in found.differences)]
    return Reply(found, "\n".join(lines), code=ExitCode.GOAL_NOT_MET if found.differences else ExitCode.GOAL_MET)


def _show_bag(found: BagVerdict) -> Reply[BagVerdict]:
    """Exit code 0 where every criterion is true."""
    lines = [f"{found.bag}: {found.verdict}, by {found.robot} in {found.scene}", *map(_render, found.criteria)]
    for look in found.looks:
        frames = ", ".join(f"{each.camera} ({each.color}, stamp {each.stamp_ns})" for each in look.frames)
        lines.append(f"  {look.role} at {look.time_s:.2f} s: {frames}")
    lines += [f"  left out: {each}" for each in found.left_out]
    code = ExitCode.GOAL_MET if found.verdict is Truth.TRUE else ExitCode.GOAL_NOT_MET
    return Reply(found, "\n".join(lines), [f"looks, pictures and verdict in {found.evidence}"], code)


def _render(criterion: Criterion) -> str:
    return f"  {criterion.truth}: {criterion.kind} {criterion.text}: {criterion.because}"
