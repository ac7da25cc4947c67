"""Numbers as people say them: lengths in mm, cm or m, angles in degrees, shares in percent, and counts in words.

Sentences with these are for people. What a program needs stands beside them in typed fields, unrounded, in SI units.
"""

import math
from collections.abc import Callable


def format_length(m: float) -> str:
    """A length [m] without its sign: `0.4 mm`, `9 mm`, `30 cm`, `1.25 m`."""
    size_m = abs(m)
    if size_m < 0.0995:
        return f"{1e3 * size_m:.{int(0.0 < size_m < 9.5e-4)}f} mm"
    return f"{100 * size_m:.0f} cm" if size_m < 0.995 else f"{size_m:.2f} m"


def format_angle(rad: float) -> str:
    """The size of an angle [rad]: `15°`, `0.3°`."""
    degrees = abs(math.degrees(rad))
    return f"{degrees:.{int(0.05 <= degrees < 0.95)}f}°"


def format_share(share: float) -> str:
    """A share, 0..1: `75 %`."""
    return f"{100 * share:.0f} %"


def compare_lengths(m: float, limit_m: float) -> tuple[str, str]:
    """A length and its limit [m], with a digit more where they would read the same."""
    return _tell_apart(m, limit_m, format_length, lambda size_m: f"{1e3 * abs(size_m):.1f} mm")


def compare_angles(rad: float, limit_rad: float) -> tuple[str, str]:
    """The same of angles [rad]."""
    return _tell_apart(rad, limit_rad, format_angle, lambda size_rad: f"{abs(math.degrees(size_rad)):.1f}°")


def _tell_apart(
    value: float, limit: float, short: Callable[[float], str], longer: Callable[[float], str]
) -> tuple[str, str]:
    words = longer if short(value) == short(limit) and not math.isclose(value, limit) else short
    return words(value), words(limit)


def format_time(iso: str) -> str:
    """A wall time, UTC, to the second: `2026-11-30 07:43:05 UTC`."""
    return f"{iso[:19].replace('T', ' ')} UTC"


def count(number: int, noun: str, plural: str = "") -> str:
    """`1 session`, `2 sessions`; the noun takes an s unless its plural is given."""
    return f"{number} {noun if number == 1 else plural or noun + 's'}"


def count_criteria(held: int, total: int) -> str:
    """How many criteria hold, as a clause: `the criterion holds`, `both criteria hold`, `2 of 4 criteria hold`."""
    if not total:
        return "no criterion is stated"
    if total == 1:
        return "the criterion holds" if held else "the criterion does not hold"
    if held < total:
        return f"{held or 'none'} of {total} criteria hold{'s' if held == 1 else ''}"
    return "both criteria hold" if total == 2 else f"all {total} criteria hold"
