"""The target as it runs against its profile, and both against runtime_contract.yaml."""

import math
from collections.abc import Iterator
from typing import Any

from phyagentos.errors import Problem, format_names
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime
from phyagentos.protocol.capabilities.targets import TargetProfile, find_driver_name
from phyagentos.protocol.settings.runtime_contract import RuntimeContract
from phyagentos.runtime.preflight.findings import make_problem
from phyagentos.runtime.targets.wire import WIRE_VERSION, Description

RELATIVE_TOLERANCE = 1e-6


def iter_handshake_problems(profile: TargetProfile, contract: RuntimeContract, live: Description) -> Iterator[Problem]:
    """Where the live target differs from TARGETS.md and runtime_contract.yaml."""
    by = "TARGETS.md"
    steps = round(profile.control_period_s / profile.physics_step_s)
    pairs: dict[str, tuple[Any, Any]] = {
        "target": (live.target, profile.target),
        "n_joints": (live.n_joints, len(profile.arm.joints)),
        "steps_per_command": (live.steps_per_command, steps),
        "physics_step_s": (live.physics_step_s, profile.physics_step_s),
        "end_effector": (live.end_effector, profile.end_effector),
    }
    if live.n_joints == len(profile.arm.joints):
        pairs["joints"] = (", ".join(live.joints) or "(none)", ", ".join(profile.arm.joints))
    driver = find_driver_name(profile)
    if not driver:
        fix = "Name a driver in the target's profile; a simulation never stands in for a real robot."
        yield make_problem("NO_DRIVER", "target.driver", f"kind {profile.kind!r}", "a driver", by, fix)
    else:
        pairs["driver"] = (live.driver.split("/")[0], driver)
    for name, (found, expected) in pairs.items():
        if found != expected:
            fix = "TARGETS.md and the running target must be the same robot."
            yield make_problem("TARGET_MISMATCH", f"target.{name}", str(found), str(expected), by, fix)
    for name in ("observations", "actions"):
        offered = getattr(live, name)
        for each in getattr(profile, name):
            if each not in offered:
                found = format_names(offered)
                yield make_problem("TARGET_MISMATCH", f"target.{name}", found, repr(each), by)
    if live.mode != contract.world_mode:
        address = "runtime_contract.yaml: world_mode"
        asked_by = f"target {profile.target}, as it runs"
        yield make_problem("CONTRACT_MISMATCH", address, contract.world_mode, live.mode, asked_by)
    if live.version != WIRE_VERSION:
        found, expected = f"version {live.version}", f"version {WIRE_VERSION}"
        fix = "Start target and worker from the same installation."
        yield make_problem("VERSION_MISMATCH", "target.wire", found, expected, "this runtime", fix)


def iter_live_ability_problems(skill: SkillRuntime, profile: TargetProfile, live: Description) -> Iterator[Problem]:
    """What the profile promises, the skill needs and the live target does not give."""
    if "render" in skill.needs.operations and not live.cameras:
        by = f"skill {skill.skill}: needs.operations"
        fix = f"Give the scene of {profile.target} a camera."
        yield make_problem("OPERATION_UNAVAILABLE", "target.cameras", "none", "a camera", by, fix)


def iter_timing_problems(profile: TargetProfile, contract: RuntimeContract) -> Iterator[Problem]:
    """Where periods, steps and rates of the two differ; a target without physics has no step of it."""
    by = f"target {profile.target}"
    names = ["control_period_s"] + ([] if not profile.model else ["physics_step_s"])
    for name in names:
        found, expected = getattr(contract, name), getattr(profile, name)
        if not math.isclose(found, expected, rel_tol=RELATIVE_TOLERANCE):
            address, fix = f"runtime_contract.yaml: {name}", "Both sides of the wire must count on the same."
            yield make_problem("CONTRACT_MISMATCH", address, found, f"{expected:g}", f"{by}: {name}", fix)
    rate_hz = 1.0 / profile.control_period_s
    if contract.sampling_hz > rate_hz * (1.0 + RELATIVE_TOLERANCE):
        address = "runtime_contract.yaml: sampling_hz"
        asked_by = f"{by}: control_period_s"
        fix = "Lower it: the world is observed once in a control period."
        yield make_problem("CONTRACT_MISMATCH", address, contract.sampling_hz, f"at most {rate_hz:g} Hz", asked_by, fix)
    steps = profile.control_period_s / profile.physics_step_s
    if not math.isclose(steps, max(round(steps), 1), rel_tol=RELATIVE_TOLERANCE):
        address, asked_by = "target.control_period_s", f"{by}: physics_step_s"
        whole = f"a whole number of physics steps of {profile.physics_step_s:g} s"
        yield make_problem("CONTRACT_MISMATCH", address, profile.control_period_s, whole, asked_by)
