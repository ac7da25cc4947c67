"""Calibration of an SO-101: a person holds and moves the arm, its servos say where they stand.

The zero is first where the person puts it, by eye. Where a joint's way is that of the model, both ends are its stops,
and the zero is moved to agree with them.
"""

from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, Problem, raise_any
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.drivers.devices.device_driver import read_settings
from phyagentos.runtime.drivers.devices.so101_bus import STEP_RAD, So101Bus, So101Settings
from phyagentos.runtime.models.robot import compile_robot
from phyagentos.runtime.targets.driver_registry import Ask

MARGIN_RAD = 0.035  # of ranges to the stops
STOPS_RAD = 0.06  # so near to the model's way is one from stop to stop
EYE_RAD = 0.35  # so far may a joint stand from the posture that it was to have
JAW_STEPS = 300  # the least way of the jaw


def calibrate_so101(sdk: ModuleType, profile: TargetProfile, folder: Path, clock: Clock, ask: Ask) -> dict[str, object]:
    """The settings that differ by arm, measured.

    Raises:
        DefinitionError: Of the profile or its model; `INVALID_VALUE` with every joint that cannot be as was measured.
        ExecutionError: `TARGET_LOST`.
    """
    settings = read_settings(So101Settings, profile)
    model = compile_robot(profile, folder)
    ranges = [model.joint(name).range.tolist() for name in profile.arm.joints]
    bus = So101Bus(sdk, profile, settings)
    try:
        ask("Hold the arm: its servos let go.")
        bus.release()
        ask(f"Put it into the posture that `paos robot render {profile.target}` draws, the jaw closed.")
        *home, closed = bus.read_steps()
        ask("Open the jaw as wide as it goes.")
        opened = bus.read_steps()[-1]
        ends = []
        for index, name in enumerate(profile.arm.joints):
            ask(f"Turn {name} to its lower end, as the model counts.")
            low = bus.read_steps()[index]
            ask(f"Turn {name} to its upper end.")
            ends.append((low, bus.read_steps()[index]))
        offsets = bus.read_offsets()
    finally:
        bus.close()
    found = _measure(profile, home, ends, ranges)
    jaw = {"jaw_closed_steps": closed, "jaw_open_steps": opened}
    if abs(opened - closed) < JAW_STEPS:
        place = f"{profile.target}: jaw"
        raise DefinitionError.of("INVALID_VALUE", place, f"{closed} to {opened} steps", f"{JAW_STEPS} or more")
    return found | jaw | {"calibrated_at": clock.wall_iso(), "offsets": offsets}


def _measure(
    profile: TargetProfile, home: Sequence[int], ends: Sequence[tuple[int, int]], ranges: Sequence[Sequence[float]]
) -> dict[str, object]:
    """Zeros, directions and ranges of postures [steps] and ranges of the model [rad]; raises `INVALID_VALUE`."""
    zeros, ways, lows, highs, problems = [], [], [], [], list[Problem]()
    rows = zip(profile.arm.joints, profile.arm.home_rad, home, ends, ranges, strict=True)
    for name, home_rad, stood, (low, high), (least, most) in rows:
        way = 1 if high > low else -1
        zero = stood - way * home_rad / STEP_RAD
        if abs(abs(high - low) * STEP_RAD - (most - least)) <= STOPS_RAD:
            zero, by_eye = 0.5 * (low + high) - way * 0.5 * (least + most) / STEP_RAD, zero
            if abs(zero - by_eye) * STEP_RAD > EYE_RAD:
                found = f"{abs(zero - by_eye) * STEP_RAD:.2f} rad between its posture in the picture and its ends"
                problems.append(Problem("INVALID_VALUE", f"{profile.target}: {name}", found, f"{EYE_RAD} or less"))
        ends_rad = [way * (each - zero) * STEP_RAD for each in (low, high)]
        if not (least - EYE_RAD < ends_rad[0] < home_rad < ends_rad[1] < most + EYE_RAD):
            found = f"steps {low}, {stood}, {high} at its lower end, in the picture, at its upper end"
            expected = f"{least:.2f} to {most:.2f} rad, without a count from 4095 to 0"
            problems.append(Problem("INVALID_VALUE", f"{profile.target}: {name}", found, expected))
        zeros.append(round(zero))
        ways.append(way)
        lows.append(round(max(ends_rad[0], least) + MARGIN_RAD, 4))
        highs.append(round(min(ends_rad[1], most) - MARGIN_RAD, 4))
    raise_any(problems)
    return {"zero_steps": zeros, "directions": ways, "q_min_rad": lows, "q_max_rad": highs}
