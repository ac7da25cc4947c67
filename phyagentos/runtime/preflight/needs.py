"""Needs of a skill, offers of the target, permissions of the site; the target as it runs against what is declared."""

import math
from collections.abc import Iterable, Iterator, Mapping
from importlib.metadata import version
from typing import Any

import msgspec
from packaging.specifiers import InvalidSpecifier, SpecifierSet

from phyagentos.errors import Problem, format_names
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime
from phyagentos.protocol.capabilities.targets import TargetProfile, find_driver_name
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.settings.operations import CORE_OPERATIONS, SESSION_OPERATIONS, Operation
from phyagentos.protocol.settings.runtime_contract import RuntimeContract
from phyagentos.protocol.world.scenes import Body, SceneSpec
from phyagentos.runtime.preflight.findings import make_problem
from phyagentos.runtime.targets.wire import WIRE_VERSION, Description

STANDARD_GRAVITY_M_S2 = 9.80665
RELATIVE_TOLERANCE = 1e-6


def iter_ability_problems(skill: SkillRuntime, profile: TargetProfile) -> Iterator[Problem]:
    """Observations, actions and capabilities that the target does not offer."""
    needs = skill.needs
    offers = (
        ("observation", "observations", needs.observations, profile.observations),
        ("action", "actions", needs.actions, profile.actions),
        ("capability", "capabilities", needs.capabilities, profile.capabilities),
    )
    for kind, name, needed, offered in offers:
        for need in needed:
            if need not in offered:
                found = Problem.unknown(
                    kind,
                    f"skill.needs.{name}",
                    need,
                    offered,
                    by=f"skill {skill.skill}: needs.{name}",
                    fix=f"Choose a target that offers it; {profile.target} does not.",
                )
                yield msgspec.structs.replace(found, code="NOT_OFFERED")


def iter_resource_problems(session: Session, contract: RuntimeContract) -> Iterator[Problem]:
    """Undeclared resources: two sessions with two names for one object could hold it at once."""
    for index, name in enumerate(session.resources):
        if name not in contract.resources:
            address, by = f"resources[{index}]", "runtime_contract.yaml: resources"
            yield Problem.unknown(
                "resource",
                address,
                name,
                contract.resources,
                by=by,
                fix="Add it to 'resources' of runtime_contract.yaml.",
            )


def find_operations(skill: SkillRuntime) -> tuple[Operation, ...]:
    """The operations that a skill cannot do without."""
    of_policy = skill.policy.operations if skill.policy is not None else ()
    return tuple(dict.fromkeys((*CORE_OPERATIONS, *skill.needs.operations, *of_policy)))


def find_exposed(skill: SkillRuntime, profile: TargetProfile, contract: RuntimeContract) -> tuple[Operation, ...]:
    """The granted operations: needed or usual, offered and permitted."""
    usual = dict.fromkeys((*SESSION_OPERATIONS, *find_operations(skill)))
    return tuple(each for each in usual if each in profile.operations and each in contract.operations)


def iter_operation_problems(
    skill: SkillRuntime, profile: TargetProfile, contract: RuntimeContract
) -> Iterator[Problem]:
    """Operations that the target lacks, or that a session may not use here."""
    for each in find_operations(skill):
        by = f"skill {skill.skill}: {'every session' if each in CORE_OPERATIONS else 'needs.operations'}"
        code, address, offered = "NOT_OFFERED", "target.operations", profile.operations
        fix = f"{profile.target} cannot do it; choose another target."
        if each in offered:
            code, address, offered = "NOT_PERMITTED", "runtime_contract.yaml: operations", contract.operations
            fix = f"Permit {each!r} in runtime_contract.yaml, if sessions may do that here."
        if each not in offered:
            yield make_problem(code, address, repr(each), format_names(offered), by, fix)


def iter_version_problems(skill: SkillRuntime) -> Iterator[Problem]:
    """A skill that was written for another version of this software."""
    wanted = skill.needs.phyagentos
    if not wanted:
        return
    address, by = "skill.needs.phyagentos", f"skill {skill.skill}: needs.phyagentos"
    found = version("phyagentos")
    try:
        fits = SpecifierSet(wanted).contains(found, prereleases=True)
    except InvalidSpecifier:
        yield make_problem("VERSION_MISMATCH", address, repr(wanted), "versions as in '>=0.2,<1' (PEP 440)", by)
        return
    if not fits:
        yield make_problem("VERSION_MISMATCH", address, f"phyagentos {found}", wanted, by)


def iter_payload_problems(
    grasped: Iterable[str], skill: SkillRuntime, spec: SceneSpec, profile: TargetProfile
) -> Iterator[Problem]:
    """Sure grasps of the skill of what may weigh more than the arm carries, or surely slips out of the hand.

    Of a declared span of weights the top decides what is too heavy, the bottom what is too slippery.
    """
    carried_kg = profile.arm.payload_kg - profile.gripper.mass_kg
    press_n = profile.gripper.force_n
    by = f"skill {skill.skill}: its grasp"
    for name in grasped:
        whole = _find_lifted(name, spec.bodies)
        if not whole:
            continue
        least_kg, load_kg = _sum_up_kg(whole, spec.bodies)
        address = f"scene {spec.scene}: bodies.{name}"
        if load_kg > carried_kg:
            fix = f"Choose another object or target; {profile.target} carries arm.payload_kg less gripper.mass_kg."
            found, expected = f"up to {load_kg:g} kg", f"at most {carried_kg:g} kg"
            yield make_problem("NOT_GRASPABLE", f"{address}.mass_kg", found, expected, by, fix)
        body = spec.bodies[name]
        borne_n = 2.0 * press_n * body.grip_span[1] if body.grip_span is not None else math.inf
        if STANDARD_GRAVITY_M_S2 * least_kg > borne_n and body.interior is None:  # a vessel may hang on its rim
            found = f"at least {STANDARD_GRAVITY_M_S2 * least_kg:.1f} N of weight"
            expected = f"at most {borne_n:.1f} N, which two fingers of {press_n:g} N bear by friction"
            fix = "Choose another object, or a skill that does not lift it."
            yield make_problem("NOT_GRASPABLE", f"{address}.grip_span", found, expected, by, fix)


def _find_lifted(name: str, bodies: Mapping[str, Body]) -> str:
    """The object that is lifted with this one; empty for what stands fixed, or is pulled or pushed in a joint."""
    while name in bodies and (whole := bodies[name].part_of) is not None:
        name = whole
    return name if name in bodies and not bodies[name].fixed and bodies[name].joint is None else ""


def _sum_up_kg(name: str, bodies: Mapping[str, Body]) -> tuple[float, float]:
    """Least and greatest weight of an object with all that is fixed to it, and what it holds."""
    own, filling = bodies[name].mass_span_kg or (bodies[name].mass_kg, bodies[name].mass_kg), bodies[name].contents
    parts = [_sum_up_kg(part, bodies) for part, each in bodies.items() if each.part_of == name]
    parts += [(filling.count * filling.mass_kg,) * 2] if filling is not None else []
    return own[0] + sum(each[0] for each in parts), own[1] + sum(each[1] for each in parts)


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
        pairs["joints"] = (", ".join(live.joints) or "(none)", ", ".join(profile.arm.joints) or "(none)")
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
        yield make_problem(
            "CONTRACT_MISMATCH",
            address="runtime_contract.yaml: world_mode",
            found=contract.world_mode,
            expected=live.mode,
            triggered_by=f"target {profile.target}, as it runs",
        )
    if live.version != WIRE_VERSION:
        found, expected = f"version {live.version}", f"version {WIRE_VERSION}"
        fix = "Start target and worker from the same installation."
        yield make_problem("VERSION_MISMATCH", "target.wire", found, expected, "this runtime", fix)


def iter_live_ability_problems(skill: SkillRuntime, profile: TargetProfile, live: Description) -> Iterator[Problem]:
    """What the profile promises, the skill needs and the live target does not give."""
    if "render" in skill.needs.operations and not live.cameras:
        yield make_problem(
            "NOT_OFFERED",
            "target.cameras",
            "none",
            "a camera",
            triggered_by=f"skill {skill.skill}: needs.operations",
            fix=f"Give the scene of {profile.target} a camera.",
        )


def iter_timing_problems(profile: TargetProfile, contract: RuntimeContract) -> Iterator[Problem]:
    """Where periods, steps and rates of the two differ; a target without physics has no step of it."""
    by = f"target {profile.target}"
    for name in ["control_period_s"] + ([] if not profile.model else ["physics_step_s"]):
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
        yield make_problem(
            "CONTRACT_MISMATCH",
            address,
            profile.control_period_s,
            expected=f"a whole number of physics steps of {profile.physics_step_s:g} s",
            triggered_by=asked_by,
        )
