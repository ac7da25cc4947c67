"""safety.yaml against the target: one number per joint, no wider than its own, enforceable, room left to work.

The guard narrows the limits to those of the live target. A limit that is wider than the target's own is refused all the
same, since its author believed in a motion that the target cannot make.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import Problem
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.settings.safety import PER_JOINT, Limit, TargetLimits
from phyagentos.protocol.world.environment import Environment
from phyagentos.runtime.actions.handle import EXPIRY_PERIODS
from phyagentos.runtime.actions.tool_point import ToolPoint
from phyagentos.runtime.preflight.findings import make_problem
from phyagentos.runtime.targets.wire import Description

POSITION_TOLERANCE_RAD = 0.02  # a target keeps a margin before its end stops; the guard keeps it too
RELATIVE_TOLERANCE = 1e-6
TOOL_TOLERANCE_M = 0.005  # what a calibrated arm and its nominal model differ by, with room
LEANING_TOLERANCE_M = 0.03  # what a metre above the ground moves as a body on legs or wheels leans by 1.7 degrees

Array = NDArray[np.float64]
_OWN = (
    ("joint_velocity_max", "velocity_rad_s"),
    ("joint_acceleration_max", "acceleration_rad_s2"),
    ("joint_jerk_max", "jerk_rad_s3"),
)
_NARROW = "Widen it: no session could move under it."


def iter_safety_problems(limits: TargetLimits, profile: TargetProfile) -> Iterator[Problem]:
    """Problems on paper."""
    bad = list(_iter_length_problems(limits, profile))
    yield from bad
    wrong = {problem.address for problem in bad}
    n = len(profile.arm.joints)
    for name, field in _OWN:
        if _place(profile, name) not in wrong and len(getattr(profile.arm, field)) == n:
            yield from _iter_wider(
                profile,
                name,
                _spread(getattr(limits, name), n),
                own=np.asarray(getattr(profile.arm, field)) * (1.0 + RELATIVE_TOLERANCE),
                whose=f"arm.{field}",
            )
    if not {_place(profile, "joint_position_min"), _place(profile, "joint_position_max")} & wrong:
        low, high = _spread(limits.joint_position_min, n), _spread(limits.joint_position_max, n)
        yield from _iter_range_problems(profile, low, high)
    yield from _iter_box_problems(limits, profile)
    yield from _iter_number_problems(limits, profile)


def iter_live_safety_problems(limits: TargetLimits, profile: TargetProfile, live: Description) -> Iterator[Problem]:
    """Against the live target: its joint ranges, its kinematics, the force of its gripper."""
    n = live.n_joints
    low, high = limits.joint_position_min, limits.joint_position_max
    if _fits(low, n) and _fits(high, n):
        own_low = np.asarray(live.q_min_rad) - POSITION_TOLERANCE_RAD
        own_high = np.asarray(live.q_max_rad) + POSITION_TOLERANCE_RAD
        yield from _iter_wider(profile, "joint_position_min", -_spread(low, n), -own_low, "its end stops", sign=-1.0)
        yield from _iter_wider(profile, "joint_position_max", _spread(high, n), own_high, "its end stops")
    yield from _iter_kinematics_problems(profile, live)
    yield from _iter_force_problems(limits, profile, live.gripper_force_n)


def _iter_kinematics_problems(profile: TargetProfile, live: Description) -> Iterator[Problem]:
    """Without kinematics the tool would be seen outside only once it is there."""
    chain, n = live.kinematics, len(profile.arm.joints)
    if chain is not None and {len(chain.axes), len(chain.anchors_m), len(chain.slides or chain.axes)} == {n}:
        return
    yield make_problem(
        "LIMIT_INVALID",
        "target.kinematics",
        found="none described" if chain is None else f"{len(chain.axes)} axes, {len(chain.anchors_m)} anchors",
        expected=f"where each of {n} joints brings the tool",
        triggered_by="safety.yaml: workspace_box, keep_out",
        fix="Let the target's description declare which way each joint turns or slides, and about which point.",
        kind="unenforceable",
    )


def _iter_force_problems(limits: TargetLimits, profile: TargetProfile, own_n: float) -> Iterator[Problem]:
    force_n = float(np.asarray(limits.gripper_force_max.value))
    if own_n <= force_n * (1.0 + RELATIVE_TOLERANCE):  # never true of NaN
        return
    found, fix = "a gripper whose force the target does not declare", "Let the target declare its force."
    if not math.isnan(own_n):
        found = f"{own_n:g} N, which the gripper can press with"
        fix = "Use a weaker gripper, or raise the limit with a source."
    place, by = _place(profile, "gripper_force_max"), "safety.yaml: gripper_force_max"
    yield make_problem("GRIPPER_FORCE", place, found, f"at most {force_n:g} N", by, fix)


def iter_start_problems(limits: TargetLimits, profile: TargetProfile, now: Environment) -> Iterator[Problem]:
    """Where the tool stands now: the guard refuses every command of a session that begins outside."""
    state = now.targets.get(profile.target)
    if state is None:
        return
    point = np.asarray(state.tcp.position_m)
    boxes = {"workspace_box": limits.workspace_box}
    boxes |= {f"keep_out.{name}": limit for name, limit in limits.keep_out.items()}
    for name, limit in boxes.items():
        low, high = np.asarray(limit.value)
        is_room = name == "workspace_box"
        if bool(((low <= point) & (point <= high)).all() if is_room else not ((low < point) & (point < high)).all()):
            continue  # never true of NaN in the workspace
        yield make_problem(
            "START_OUTSIDE",
            _place(profile, name),
            found=f"the tool stands at {_show(point)}",
            expected=f"{'inside' if is_room else 'outside'} {_show(low)} to {_show(high)}",
            triggered_by=f"safety.yaml: {name}",
            fix="Move the robot by hand, or correct the box.",
        )


def iter_tool_problems(profile: TargetProfile, live: Description, now: Environment) -> Iterator[Problem]:
    """Whether the tool stands where the described kinematics bring it; else the guard would check another place."""
    state, chain = now.targets.get(profile.target), live.kinematics
    if state is None or chain is None or not np.isfinite(state.tcp.position_m).all():
        return
    try:
        point = ToolPoint(chain).compute(np.asarray(state.q_rad, dtype=np.float64))
    except ValueError:  # another number of joints, which is reported already
        return
    away_m = math.dist(point, state.tcp.position_m)
    allowed_m = TOOL_TOLERANCE_M if profile.base is None else LEANING_TOLERANCE_M
    if not away_m <= allowed_m:
        yield make_problem(
            "LIMIT_INVALID",
            "target.kinematics",
            found=f"they bring the tool to {_show(point)} m, {away_m:.3g} m from where it stands",
            expected=f"{_show(state.tcp.position_m)} m, within {allowed_m} m",
            triggered_by="safety.yaml: workspace_box, keep_out",
            fix="Let the target declare the kinematics of this arm, with this tool, where it is mounted.",
            kind="unenforceable",
        )


def _iter_length_problems(limits: TargetLimits, profile: TargetProfile) -> Iterator[Problem]:
    n, by = len(profile.arm.joints), f"target {profile.target}: arm.joints"
    for name in PER_JOINT:
        limit = getattr(limits, name)
        if not _fits(limit, n):
            found = f"{len(limit.value)} numbers"
            yield make_problem("INVALID_VALUE", _place(profile, name), found, f"one, or {n}: one per joint", by)
    arm = profile.arm
    fields = ("home_rad", "velocity_rad_s", "acceleration_rad_s2", "jerk_rad_s3", "torque_nm", "stiffness_nm_rad")
    for field in (*fields, "damping_nms_rad"):
        if len(getattr(arm, field)) != n:
            found = f"{len(getattr(arm, field))} numbers"
            yield make_problem("INVALID_VALUE", f"target.arm.{field}", found, f"{n}: one per joint", by)


def _iter_range_problems(profile: TargetProfile, low: Array, high: Array) -> Iterator[Problem]:
    home = profile.arm.home_rad
    outside = [
        joint
        for index, joint in enumerate(profile.arm.joints)
        if index < len(home) and not low[index] <= home[index] <= high[index]
    ]
    if outside:
        found = f"{', '.join(outside)} stands outside in the home posture"
        yield make_problem(
            "LIMIT_INVALID",
            _place(profile, "joint_position_min"),
            found,
            expected="a range that holds arm.home_rad",
            triggered_by=f"target {profile.target}: arm.home_rad",
            fix=_NARROW,
            kind="too narrow",
        )


def _iter_box_problems(limits: TargetLimits, profile: TargetProfile) -> Iterator[Problem]:
    if profile.workspace_m is None:
        return
    low, high = np.asarray(limits.workspace_box.value)
    own_low, own_high = np.asarray(profile.workspace_m)
    if np.any(low < own_low - RELATIVE_TOLERANCE) or np.any(high > own_high + RELATIVE_TOLERANCE):
        yield make_problem(
            "LIMIT_INVALID",
            _place(profile, "workspace_box"),
            found=f"{_show(low)} to {_show(high)}",
            expected=f"inside {_show(own_low)} to {_show(own_high)}",
            triggered_by=f"target {profile.target}: workspace_m",
            fix="Put it inside the target's own box, at which the target stops by itself.",
            kind="too wide",
        )


def _iter_number_problems(limits: TargetLimits, profile: TargetProfile) -> Iterator[Problem]:
    """Limits of one number, against what the target does in one control period."""
    by, period_s = f"target {profile.target}", profile.control_period_s
    bounds = (  # limit, its unit, the least and the greatest that the target allows, where it declares them
        ("gripper_width_max", "m", -math.inf, profile.gripper.max_width_m or math.inf, "gripper.max_width_m"),
        ("command_rate_max", "1/s", 1.0 / period_s, 1.0 / period_s, "control_period_s"),
        ("command_validity_max", "s", EXPIRY_PERIODS * period_s, math.inf, "control_period_s"),
    )
    for name, unit, least, most, field in bounds:
        value, place, by_field = float(np.asarray(getattr(limits, name).value)), _place(profile, name), f"{by}: {field}"
        found = f"{value:g} {unit}"
        if value > most * (1.0 + RELATIVE_TOLERANCE):
            yield make_problem("LIMIT_INVALID", place, found, f"at most {most:g} {unit}", by_field, kind="too wide")
        elif value < least * (1.0 - RELATIVE_TOLERANCE):
            yield make_problem(
                "LIMIT_INVALID",
                place,
                found,
                expected=f"at least {least:g} {unit}",
                triggered_by=by_field,
                fix=_NARROW,
                kind="too narrow",
            )


def _iter_wider(
    profile: TargetProfile, name: str, values: Array, own: Array, whose: str, sign: float = 1.0
) -> Iterator[Problem]:
    for index, joint in enumerate(profile.arm.joints[: len(own)]):
        if not values[index] <= own[index]:  # also when the target declares NaN
            yield make_problem(
                "LIMIT_INVALID",
                address=f"{_place(profile, name)}[{index}]",
                found=f"{joint} {sign * values[index]:g}",
                expected=f"{'at least' if sign < 0 else 'at most'} {sign * own[index]:g}",
                triggered_by=f"target {profile.target}: {whose}",
                fix="A limit may narrow what the target can do, never widen it.",
                kind="too wide",
            )


def _place(profile: TargetProfile, name: str) -> str:
    return f"safety.yaml: targets.{profile.target}.{name}"


def _fits(limit: Limit, n: int) -> bool:
    return np.asarray(limit.value).shape in {(), (n,)}


def _spread(limit: Limit, n: int) -> Array:
    """(n,) numbers of a limit that may be one for all joints."""
    return np.broadcast_to(np.asarray(limit.value, dtype=np.float64), (n,))


def _show(point: Sequence[float] | Array) -> str:
    return f"({', '.join(f'{value:g}' for value in np.round(point, 3))})"
