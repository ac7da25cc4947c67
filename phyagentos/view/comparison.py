"""Two sessions, or two runs of a suite, side by side: what differs."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from phyagentos.errors import DefinitionError, get_known
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.evidence import TRAJECTORY
from phyagentos.protocol.sessions.session import SessionId, SessionStatus
from phyagentos.protocol.workspace.array_files import read_arrays
from phyagentos.view.documents import Documents
from phyagentos.view.plots import join_points, thin

_MOVED_M = 0.005  # less is not shown
_WIDTH, _HEIGHT, _POINTS = 360, 70, 120  # of a chart [px], and most points of a curve
_OF_COURSE = frozenset({"id", "attempt", "parent", "advice", "advised_by", "goal_left_s"})


def compare_sessions(documents: Documents, first: str, second: str) -> Fields:
    """Values of the template `compare`; raises DefinitionError `UNKNOWN_NAME`."""
    both = [get_known("session", "compare", SessionId(id), documents.ledger.sessions) for id in (first, second)]
    contracts = [flatten(msgspec.to_builtins(each.contract)) for each in both]
    keys = dict.fromkeys([*contracts[0], *contracts[1]])
    differ = [key for key in keys if contracts[0].get(key) != contracts[1].get(key) and key not in _OF_COURSE]
    courses = [_read_course(documents, each) for each in both]
    texts = dict.fromkeys(
        each.text for status in both for each in (status.decision.criteria if status.decision else ())
    )
    return {
        "both": both,
        "parameters": [(key, *(each.get(key, "") for each in contracts)) for key in differ],
        "criteria": [(text, *(_find_criterion(status, text) for status in both)) for text in texts],
        "charts": _draw_charts(courses),
        "figures": [(name, *(_measure(course).get(name, "") for course in courses)) for name in _measure(courses[0])],
        "moved": [list_moved(documents, each) for each in both],
        "leaves": [[event for event in documents.read_bundle(each).trace if event.code] for each in both],
    }


def flatten(value: Mapping[str, Any], above: str = "") -> Fields:
    """Nested mappings as one, with paths as keys; lists in words."""
    flat: Fields = {}
    for name, each in value.items():
        key = f"{above}.{name}" if above else str(name)
        if isinstance(each, Mapping):
            flat |= flatten(each, key)
        else:
            flat[key] = ", ".join(map(str, each)) if isinstance(each, list | tuple) else each
    return flat


def _find_criterion(status: SessionStatus, text: str) -> Any:
    return next((each for each in (status.decision.criteria if status.decision else ()) if each.text == text), None)


def _read_course(documents: Documents, status: SessionStatus) -> Fields:
    path = documents.workspace.evidence_of(status.contract.id) / TRAJECTORY
    return read_arrays(path) if path.is_file() else {}


def _measure(course: Mapping[str, Any]) -> dict[str, str]:
    """Figures of a trajectory, in words."""
    if not course or len(course["time_s"]) < 2:
        return {"duration": "nothing commanded", "joint path": "", "greatest joint speed": "", "greatest lag": ""}
    return {
        "duration": f"{course['time_s'][-1] - course['time_s'][0]:.2f} s",
        "joint path": f"{np.abs(np.diff(course['q_measured'], axis=0)).sum():.2f} rad",
        "greatest joint speed": f"{np.abs(course['qd_measured']).max():.2f} rad/s",
        "greatest lag": f"{np.abs(course['q_commanded'] - course['q_measured']).max():.4f} rad",
    }


def _draw_charts(courses: list[Fields]) -> list[tuple[str, str]]:
    """Name and SVG of each joint and the gripper, both sessions from their start on one scale."""
    if not all(len(course.get("time_s", ())) > 1 for course in courses):
        return []
    curves = [
        {f"joint {joint + 1} [rad]": course["q_measured"][:, joint] for joint in range(course["q_measured"].shape[1])}
        | {"gripper [m]": course["gripper_measured_m"]}
        for course in courses
    ]
    times = [course["time_s"] - course["time_s"][0] for course in courses]
    last_s = max(float(time[-1]) for time in times)
    charts = []
    for name in (each for each in curves[0] if each in curves[1]):
        low = min(float(each[name].min()) for each in curves)
        high = max(float(each[name].max()) for each in curves)
        lines = "".join(
            f'<polyline class="course{index}" points="{_place(time, curve[name], last_s, low, high)}"/>'
            for index, (time, curve) in enumerate(zip(times, curves, strict=True))
        )
        label = f'role="img" aria-label="{name} over {last_s:.1f} seconds, from {low:.2f} to {high:.2f}"'
        charts.append((name, f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" class="chart" {label}>{lines}</svg>'))
    return charts


def _place(time: Any, values: Any, last_s: float, low: float, high: float) -> str:
    scale = (_HEIGHT - 8) / max(high - low, 1e-9)
    return join_points(_WIDTH * time / last_s, _HEIGHT - 4 - (values - low) * scale, thin(values, _POINTS))


def list_moved(documents: Documents, status: SessionStatus) -> list[str]:
    """What is elsewhere after a session than before, as believed."""
    bundle = documents.read_bundle(status)
    if bundle.before is None or bundle.after is None:
        return []
    lines = []
    for name, entity in bundle.after.entities.items():
        before = bundle.before.entities.get(name)
        by_m = (
            0.0
            if before is None
            else float(np.linalg.norm(np.subtract(entity.pose.position_m, before.pose.position_m)))
        )
        if by_m > _MOVED_M:
            lines.append(f"{name} moved {by_m:.3f} m, {entity.status}")
    return lines


def compare_runs(folders: Mapping[str, Path], first: str, second: str) -> Fields:
    """Values of the template `runs`: the rows of two runs, and their pairs by seed.

    Raises:
        DefinitionError: `UNKNOWN_NAME` for a run that the page was not opened with; `CHANGED`.
    """
    from phyagentos.bench.records import read_records
    from phyagentos.bench.suite_file import read_suite
    from phyagentos.bench.summary import compare, summarise
    from phyagentos.bench.sweep import SUITE, read_manifest

    if unknown := next((each for each in (first, second) if each not in folders), ""):
        raise DefinitionError.unknown("run", "compare", unknown, folders)
    both = [folders[each] for each in (first, second)]
    records = [read_records(folder) for folder in both]
    rows: dict[tuple[str, ...], list[Any]] = {}
    for index, (folder, episodes) in enumerate(zip(both, records, strict=True)):
        for row in summarise(read_suite(folder / SUITE)[0], read_manifest(folder), episodes).rows:
            rows.setdefault((row.task, *row.axes.values()), [None, None])[index] = row
    return {"names": (first, second), "rows": rows, "found": compare(records[0], records[1])}
