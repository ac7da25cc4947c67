"""Commands about policies: `policy serve`, `policy replay`."""

from typing import Annotated

import typer

from phyagentos.cli.explaining import Space
from phyagentos.cli.outcome import ExitCode, print_result
from phyagentos.cli.reply import Reply
from phyagentos.operations import policy_sessions
from phyagentos.runtime.policies.exchanges import Answer


def serve(
    skill: Annotated[str, typer.Argument(help="SKILL.md, or the name of a skill, that declares the policy.")],
    model: Annotated[str, typer.Argument(help="FILE.onnx, or FILE.py:CLASS or MODULE:CLASS with start and infer.")],
    endpoint: Annotated[str, typer.Option(help="Where to listen, instead of the declared endpoint.")] = "",
) -> None:
    """Serve a policy of your own until Ctrl-C: over openpi's protocol (`openpi://`), or this project's (`tcp://`)."""
    policy_sessions.serve(skill, model, lambda where: print_result(f"serving at {where}"), endpoint=endpoint)


def replay(
    session: Annotated[str, typer.Argument(help="A session that a policy has carried out.")],
    workspace: Space,
    endpoint: Annotated[str, typer.Option(help="Whom to ask, instead of the recorded endpoint.")] = "",
    timeout_s: Annotated[float, typer.Option(help="Longest wait for one chunk [s].")] = 10.0,
) -> Reply[tuple[Answer, ...]]:
    """Show a policy once more what one was shown in a session, and compare the answers. Exit 1 where they differ."""
    found = policy_sessions.replay(workspace, session, endpoint=endpoint, timeout_s=timeout_s)
    differing = sum(not each.is_same for each in found)
    lines = [f"chunk {each.sequence:>4}  at {each.time_s:8.3f} s  {each}" for each in found]
    text = "\n".join([*lines, f"{len(found)} chunks, {differing} answered differently"])
    return Reply(found, text, code=ExitCode.GOAL_NOT_MET if differing else ExitCode.GOAL_MET)
