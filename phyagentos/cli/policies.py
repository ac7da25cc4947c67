"""Commands about policies: `policy serve`, `policy replay`."""

import importlib
import runpy
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from phyagentos.assembly.project import open_library
from phyagentos.cli.arguments import AsJson
from phyagentos.cli.explaining import Space
from phyagentos.cli.outcome import ExitCode, print_found, print_result
from phyagentos.errors import DefinitionError
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.capabilities.policy_descriptors import PolicyDescriptor
from phyagentos.protocol.capabilities.skill_runtimes import read_skill
from phyagentos.store.subjects import get_session

if TYPE_CHECKING:
    from phyagentos.runtime.policies.server import Policy

MODEL_SUFFIX = ".onnx"


def serve(
    skill: Annotated[str, typer.Argument(help="SKILL.md, or the name of a skill, that declares the policy.")],
    model: Annotated[str, typer.Argument(help="FILE.onnx, or FILE.py:CLASS or MODULE:CLASS with start and infer.")],
    endpoint: Annotated[str, typer.Option(help="Where to listen, instead of the declared endpoint.")] = "",
) -> None:
    """Serve a policy of your own until Ctrl-C: over openpi's protocol (`openpi://`), or this project's (`tcp://`)."""
    path = Path(skill)
    path = path if path.is_file() else open_library().get_skill(skill)
    declared = read_skill(path)[0].policy
    if declared is None:
        raise DefinitionError.of("POLICY_UNDECLARED", str(path), "no `policy`", "a skill of kind `policy`")
    descriptor = PolicyDescriptor.model_validate(declared.model_dump() | {"endpoint": endpoint or declared.endpoint})
    from phyagentos.runtime.policies.openpi_server import serve_openpi
    from phyagentos.runtime.policies.server import serve_policy

    serve_at = {"openpi": serve_openpi, "tcp": serve_policy}.get(descriptor.endpoint.partition(":")[0])
    if serve_at is None:
        expected = "openpi://HOST:PORT or tcp://HOST:PORT"
        raise DefinitionError.of("ENDPOINT_INVALID", "--endpoint", repr(descriptor.endpoint), expected)
    serve_at(_load(model), descriptor, lambda where: print_result(f"serving at {where}"))


def replay(
    session: Annotated[str, typer.Argument(help="A session that a policy has carried out.")],
    workspace: Space,
    endpoint: Annotated[str, typer.Option(help="Whom to ask, instead of the recorded endpoint.")] = "",
    timeout_s: Annotated[float, typer.Option(help="Longest wait for one chunk [s].")] = 10.0,
    as_json: AsJson = False,
) -> int:
    """Show a policy once more what one was shown in a session, and compare the answers. Exit 1 where they differ."""
    from phyagentos.runtime.policies.exchanges import replay_exchanges

    known = get_session(session, read_ledger(workspace, session).sessions)
    answers = replay_exchanges(workspace, known, endpoint, timeout_s)
    differing = sum(not each.is_same for each in answers)
    lines = [f"chunk {each.sequence:>4}  at {each.time_s:8.3f} s  {each}" for each in answers]
    text = "\n".join([*lines, f"{len(answers)} chunks, {differing} answered differently"])
    print_found({"chunks": len(answers), "differing": differing, "answers": answers}, text, as_json=as_json)
    return ExitCode.GOAL_NOT_MET if differing else ExitCode.GOAL_MET


def _load(model: str) -> "Policy":
    if model.endswith(MODEL_SUFFIX):
        from phyagentos.runtime.policies.onnx_policy import OnnxPolicy

        return OnnxPolicy(Path(model))
    place, _, name = model.rpartition(":")
    try:
        known = runpy.run_path(place) if place.endswith(".py") else vars(importlib.import_module(place))
        policy: Policy = known[name]()
    except (ImportError, KeyError, OSError) as error:
        expected = "FILE.onnx, FILE.py:CLASS or MODULE:CLASS"
        raise DefinitionError.of("UNKNOWN_FILE", model, f"{type(error).__name__}: {error}", expected) from error
    return policy
