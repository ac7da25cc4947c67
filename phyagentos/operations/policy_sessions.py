"""Policies that carry out skills: served to a robot, and shown once more what one was shown."""

import importlib
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from phyagentos.assembly.project import open_library
from phyagentos.errors import DefinitionError
from phyagentos.operations.workspaces import find_session
from phyagentos.protocol.capabilities.policy_descriptors import PolicyDescriptor
from phyagentos.protocol.capabilities.skill_runtimes import read_skill
from phyagentos.runtime.policies.exchanges import Answer, replay_exchanges

if TYPE_CHECKING:
    from phyagentos.runtime.policies.policy_server import Policy

MODEL_SUFFIX = ".onnx"


def serve(skill: str, model: str, on_begun: Callable[[str], None], *, endpoint: str = "") -> None:
    """Serve a policy until Ctrl-C, at the endpoint that its skill declares without another.

    `model` is FILE.onnx, or FILE.py:CLASS or MODULE:CLASS with `start` and `infer`. Raises DefinitionError
    `UNKNOWN_NAME`, `POLICY_MISMATCH`, `INVALID_VALUE`.
    """
    path = Path(skill)
    path = path if path.is_file() else open_library().get_skill(skill)
    declared = read_skill(path)[0].policy
    if declared is None:
        raise DefinitionError.of("POLICY_MISMATCH", str(path), "no `policy`", "a skill of kind `policy`")
    descriptor = PolicyDescriptor.model_validate(declared.model_dump() | {"endpoint": endpoint or declared.endpoint})
    from phyagentos.runtime.policies.openpi_server import serve_openpi
    from phyagentos.runtime.policies.policy_server import serve_policy

    serve_at = {"openpi": serve_openpi, "tcp": serve_policy}.get(descriptor.endpoint.partition(":")[0])
    if serve_at is None:
        expected = "openpi://HOST:PORT or tcp://HOST:PORT"
        raise DefinitionError.of("INVALID_VALUE", "--endpoint", repr(descriptor.endpoint), expected)
    serve_at(_load(model), descriptor, on_begun)


def replay(root: Path, session: str, *, endpoint: str = "", timeout_s: float = 10.0) -> tuple[Answer, ...]:
    """Show a policy, at the recorded endpoint without another, what one was shown in a session, and compare chunks."""
    _, status = find_session(root, session)
    return tuple(replay_exchanges(root, status.contract.id, endpoint, timeout_s))


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
        found = f"{type(error).__name__}: {error}"
        raise DefinitionError.of("UNKNOWN_NAME", model, found, expected, kind="file") from error
    return policy
