"""runtime_contract.yaml against the target: periods, steps, rates, what a command holds.

Upstream: runtime_contract.yaml, the profile. Downstream: `compatibility`.
"""

import math
from collections.abc import Iterator

from phyagentos.errors import Problem
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.settings.runtime_contract import RuntimeContract
from phyagentos.runtime.preflight.findings import make_problem

RELATIVE_TOLERANCE = 1e-6


def iter_timing_problems(profile: TargetProfile, contract: RuntimeContract) -> Iterator[Problem]:
    """Where the two say different things; a target without physics has no step of it."""
    by = f"target {profile.target}"
    names = ["control_period_s"] + ([] if not profile.model else ["physics_step_s"])
    for name in names:
        found, expected = getattr(contract, name), getattr(profile, name)
        if not math.isclose(found, expected, rel_tol=RELATIVE_TOLERANCE):
            yield make_problem(
                "CONTRACT_MISMATCH",
                f"runtime_contract.yaml: {name}",
                found,
                f"{expected:g}",
                triggered_by=f"{by}: {name}",
                fix="Both sides of the wire must count on the same.",
            )
    rate_hz = 1.0 / profile.control_period_s
    if contract.sampling_hz > rate_hz * (1.0 + RELATIVE_TOLERANCE):
        yield make_problem(
            "CONTRACT_MISMATCH",
            "runtime_contract.yaml: sampling_hz",
            contract.sampling_hz,
            f"at most {rate_hz:g} Hz",
            triggered_by=f"{by}: control_period_s",
            fix="The world is seen once in a control period.",
        )
    steps = profile.control_period_s / profile.physics_step_s
    if not math.isclose(steps, max(round(steps), 1), rel_tol=RELATIVE_TOLERANCE):
        yield make_problem(
            "CONTRACT_MISMATCH",
            "target.control_period_s",
            profile.control_period_s,
            f"a whole number of physics steps of {profile.physics_step_s:g} s",
            triggered_by=f"{by}: physics_step_s",
        )
