"""The gate before a run: what this machine lacks for an episode. Such episodes are *missing*, and say why.

Looked for: Python environments, modules, models of robots, drivers, and policy servers.
"""

import importlib.util
import shutil
import socket
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

from phyagentos.assembly.drivers import choose_driver
from phyagentos.bench.environments import find_lacks
from phyagentos.bench.suite_file import Policy, Variant
from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.capabilities.environments import EnvironmentSpec
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.models.sources import require_models

CONNECT_S = 1.0


class Gate:
    """Finds what is lacking; each environment is looked at once."""

    def __init__(self, environments: Mapping[str, EnvironmentSpec]) -> None:
        self._look_at = cache(lambda name: find_lacks(name, environments[name]) if name in environments else [])

    def find_lacks(
        self, variant: Variant, policy: Policy, targets: Sequence[tuple[TargetProfile, Path]]
    ) -> tuple[Problem, ...]:
        """What this machine lacks for the episodes of one cell, whose `targets` stand beside their profiles' files."""
        expected, hint = "a module of this Python", "Install what brings it."
        absent = [module for module in variant.needs if importlib.util.find_spec(module) is None]
        return (
            *_find_policy_lacks(policy),
            *self._look_at(variant.environment),
            *(Problem("MODULE_MISSING", module, "no such module", expected, hint) for module in absent),
            *(lack for profile, path in targets for lack in _find_target_lacks(profile, path)),
        )


def can_connect(ready: str) -> bool:
    """Whether a server listens at `host:port`."""
    host, _, port = ready.rpartition(":")
    try:
        with socket.create_connection((host, int(port)), CONNECT_S):
            return True
    except OSError:
        return False


def _find_policy_lacks(policy: Policy) -> list[Problem]:
    if policy.serve:
        found = shutil.which(policy.command[0])
        expected, hint = "a program of a policy server", "Install it, or name another one under `serve`."
        return [] if found else [Problem("POLICY_MISSING", policy.command[0], "no such program", expected, hint)]
    if policy.ready and not can_connect(policy.ready):
        hint = "Start it, or let the suite start it: `serve`."
        return [Problem("POLICY_MISSING", policy.ready, "no answer", "a policy server that listens", hint)]
    return []


def _find_target_lacks(profile: TargetProfile, path: Path) -> list[Problem]:
    try:
        choose_driver({profile.target: profile}, profile.target)
        if profile.kind == "simulation" and profile.model:
            require_models(profile, path.parent)
    except DefinitionError as error:
        return list(error.problems)
    return []
