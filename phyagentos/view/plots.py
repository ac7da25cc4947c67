"""What a session measured over time, as curves with the limits that the guard enforces."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from phyagentos.protocol.sessions import supplies
from phyagentos.protocol.settings.safety import TargetLimits, as_numbers
from phyagentos.protocol.world.environment import Environment

POINTS = 240  # of a curve, at most
_HEIGHT, _WIDTH = 100.0, 1000.0
_MAP, _MAP_EDGE = np.array((340.0, 260.0)), np.array((40.0, 24.0))  # width and height, and what labels need [pixels]
_LEAST_SHOWN = 4.0  # cells
_HEADROOM = 0.06
_NEAR = 4.0  # a limit so many times above all values would leave no room for them: it is only named
Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Plot:
    """One plot, in a frame of 1000 x 100.

    Attributes:
        title: What is shown, and its unit.
        names: Of its curves.
        curves: Points of a polyline each.
        limits: Heights of its limits, and what each is; of those that are near.
        words: Least and greatest value, for people.
        edges: Value at the upper and at the lower edge, likewise.
        time_s: First and last simulated time.
    """

    title: str
    names: tuple[str, ...]
    curves: tuple[str, ...]
    limits: tuple[tuple[float, str], ...]
    words: str
    edges: tuple[str, str]
    time_s: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Map:
    """A path and what stood around it, seen from above; y points down as on a screen.

    Attributes:
        path: Points of a polyline.
        marks: x, y [m] and kind of what was in view at the end.
        box: Least x and y, width and height [m].
        unit: What a pixel of the narrowest panel shows [m]; marks and labels are drawn in it.
    """

    path: str
    marks: tuple[tuple[float, float, str], ...]
    box: tuple[float, float, float, float]
    unit: float


def draw_map(course: Mapping[str, Array], world: Environment) -> Map | None:
    """Where a target without joints went; None where it has not said."""
    if (base := course.get(supplies.BASE)) is None or not np.isfinite(base).all():
        return None
    x, y = base[:, 0], base[:, 1]
    marks = [(*each.pose.position_m[:2], each.kind) for each in world.entities.values()]
    seen = np.array([*zip(x, y, strict=True), *(each[:2] for each in marks)])
    low, wide = seen.min(axis=0), np.maximum(np.ptp(seen, axis=0), _LEAST_SHOWN)
    unit = float((wide / (_MAP - 2 * _MAP_EDGE)).max())
    size = unit * _MAP
    corner = (low + seen.max(axis=0) - size) / 2
    return Map(join_points(x, y, np.arange(len(x))), tuple(marks), (*corner.tolist(), *size.tolist()), unit)


def draw_plots(course: Mapping[str, Array], limits: TargetLimits) -> list[Plot]:
    """Of a trajectory: joint positions, their speed, what the drive lags behind, the gripper, the force if it is felt.

    Of a target that reports such: vitals, what it carried, daylight.

    Raises ValueError where arrays of the trajectory do not fit together.
    """
    time, q = course["time_s"], course["q_measured"]
    if len(time) < 2:
        return []
    plots = _draw_joints(course, limits) if q.shape[1] else []
    for title, prefix in (("Vitals", supplies.VITAL), ("Inventory", supplies.ITEM)):
        if named := supplies.list_named(course, prefix):
            plots.append(_draw(title, tuple(named), time, list(named.values()), (None, None), "{:g}".format))
    if supplies.DAYLIGHT in course:
        light = [100 * course[supplies.DAYLIGHT]]
        plots.append(_draw("Daylight", ("daylight",), time, light, (None, None), "{:.0f} %".format))
    if "force_n" in course and np.any(course["force_n"]):
        plots.append(_draw("Contact force", ("force",), time, [course["force_n"]], (None, None), "{:.1f} N".format))
    return plots


def _draw_joints(course: Mapping[str, Array], limits: TargetLimits) -> list[Plot]:
    time, q = course["time_s"], course["q_measured"]
    low, high, fastest = (
        np.asarray(as_numbers(each))
        for each in (limits.joint_position_min, limits.joint_position_max, limits.joint_velocity_max)
    )
    joints = tuple(f"joint {number + 1}" for number in range(q.shape[1]))
    lag = np.abs(course["q_commanded"] - q).max(axis=1)
    (lag_max,), (width_max,) = as_numbers(limits.tracking_error_max), as_numbers(limits.gripper_width_max)
    percent = "{:.0f} %".format
    speed = np.abs(course["qd_measured"]) / fastest
    plots = [
        _draw(
            "Joint positions, of their range", joints, time, list((100 * (q - low) / (high - low)).T), (0, 100), percent
        ),
        _draw("Joint speeds, of their limit", joints, time, list((100 * speed).T), (None, 100), percent),
        _draw(
            "Tracking error", ("largest of all joints",), time, [1e3 * lag], (None, 1e3 * lag_max), "{:.1f} mrad".format
        ),
    ]
    if width_max > 0:
        width = [1e3 * course[f"gripper_{name}_m"] for name in ("measured", "commanded")]
        plots.append(_draw("Gripper", ("measured", "commanded"), time, width, (0, 1e3 * width_max), "{:.0f} mm".format))
    return plots


def _draw(
    title: str,
    names: tuple[str, ...],
    time: Array,
    curves: Sequence[Array],
    bounds: tuple[float | None, float | None],
    say: Callable[[float], str],
) -> Plot:
    """A plot from the lesser of 0 and all values up to the greater of a limit that is near and all values."""
    (bound, limit), least, most = bounds, float(np.min(curves)), float(np.max(curves))
    if not np.isfinite([least, most]).all() or any(len(each) != len(time) for each in curves):
        raise ValueError(f"{title}: values that are no numbers, or not one for each moment")
    is_near = limit is not None and limit <= _NEAR * most
    low, high = min(least, 0.0), max(most, limit) if limit is not None and is_near else most
    room = _HEADROOM * max(high - low, 1e-9)

    def raise_to(value: Array) -> Array:
        return _HEIGHT - _HEIGHT * (value - low + room) / (high - low + 2 * room)

    shown = [(bound, "least")] if bound is not None else []
    shown += [(limit, "limit")] if limit is not None and is_near else []
    beyond = f", limit {say(limit)}" if limit is not None and not is_near else ""
    across = _WIDTH * (time - time[0]) / max(float(time[-1] - time[0]), 1e-9)
    return Plot(
        title,
        names,
        tuple(join_points(across, raise_to(np.asarray(each)), thin(each)) for each in curves),
        tuple((round(float(raise_to(np.array(bound))), 2), f"{text} {say(bound)}") for bound, text in shown),
        f"{say(least)} to {say(most)}{beyond}",
        (say(high + room), say(low - room)),
        (float(time[0]), float(time[-1])),
    )


def thin(values: Array, most: int = POINTS) -> Indices:
    """Indices of at most about so many values, with the least and the greatest of each stretch."""
    if len(values) <= most:
        return np.arange(len(values))
    edges = np.linspace(0, len(values), most // 2 + 1).astype(int)
    found = [a + int(pick(values[a:b])) for a, b in pairwise(edges) for pick in (np.argmin, np.argmax)]
    return np.unique([0, *found, len(values) - 1])


def join_points(x: Array, y: Array, some: Indices) -> str:
    """The points of a polyline."""
    return " ".join(f"{x[index]:.1f},{y[index]:.1f}" for index in some)
