"""A real robot is calibrated by its driver, with a person at it; what was measured is written into its profile."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from phyagentos.assembly.drivers import DRIVERS
from phyagentos.assembly.project import open_library
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.documents.durable_files import replace_durably
from phyagentos.runtime.targets.driver_registry import find_driver


class CalibratedRobot(msgspec.Struct, frozen=True, kw_only=True):
    """The profile that was written, and what was measured for its `settings`."""

    file: Path
    settings: dict[str, Any]


def calibrate_robot(robot: str, ask: Callable[[str], None]) -> CalibratedRobot:
    """Measure what differs by device; `ask` requests each step of the person and returns when it is done.

    Raises:
        DefinitionError: `UNKNOWN_NAME`; `NOT_OFFERED` by a driver that has no calibration; of the driver.
        ExecutionError: `TARGET_LOST`.
    """
    file = open_library().get_target(robot)
    profile = read_target(file)
    calibrate = find_driver(DRIVERS, profile, str(file)).calibrate
    if calibrate is None:
        names = ", ".join(name for name, each in DRIVERS.load_all().items() if each.calibrate is not None)
        found = f"{profile.driver or profile.kind!r}, which has no calibration"
        hint = "Calibrate it with its maker's program." if profile.kind == "real_robot" else "It is no real robot."
        raise DefinitionError.of("NOT_OFFERED", f"{file}: driver", found, names, hint=hint)
    found_settings = dict(calibrate(profile, file.parent, SystemClock(), ask))
    text = write_settings(file.read_text(encoding="utf-8"), found_settings)
    replace_durably(file, text.encode())
    return CalibratedRobot(file=file, settings=found_settings)


def write_settings(text: str, settings: Mapping[str, object]) -> str:
    """The text of a profile with these values in its block `settings`, each on its line; comments elsewhere stay."""
    lines = text.splitlines()
    first, last = _find_entry(lines, "settings")
    kept = [line for line in lines[first + 1 : last] if line.strip().partition(":")[0] not in settings]
    new = [f"  {key}: {json.dumps(value)}" for key, value in settings.items()]
    return "\n".join([*lines[: first + 1], *kept, *new, *lines[last:]]) + "\n"


def write_entries(text: str, entries: Mapping[str, str]) -> str:
    """The text of a profile with these entries of its top level, as YAML on a line each; what is new comes last."""
    lines = text.splitlines()
    for key, value in entries.items():
        first, last = _find_entry(lines, key)
        lines[first:last] = [f"{key}: {value}"]
    return "\n".join(lines) + "\n"


def _find_entry(lines: list[str], key: str) -> tuple[int, int]:
    """The first line of an entry of the top level, and the one behind its last; both behind all lines without it."""
    first = next((k for k, line in enumerate(lines) if line.startswith(f"{key}:")), len(lines))
    last = next((k for k in range(first + 1, len(lines)) if lines[k].strip() and not lines[k][0].isspace()), len(lines))
    return first, last
