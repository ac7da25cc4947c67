"""The judges of what was recorded on the way: numbers, `metric(name) <= bound`, and conditions that hold all through.

Of a condition the recorded worst sample is judged; conditions on metrics alone use every control period.
Peaks are taken over every control period, so that a spike of one period counts. An unmeasured metric is unknown. What a
leaf or the session's outputs say of themselves is not measured: it counts only as `metric(reported_NAME)`.
"""

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from phyagentos.agent.judging.judges.judge_registry import make_unknown
from phyagentos.agent.judging.judges.predicates import evaluate_criterion
from phyagentos.protocol.predicates.measured import REPORTED
from phyagentos.protocol.predicates.predicate import (
    Predicate,
    find_formula,
    has_metric,
    is_metric_only,
    iter_metrics,
)
from phyagentos.protocol.sessions.evidence import EXECUTION, HOLDS, TRAJECTORY, Bundle
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.world.truth import Truth

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Trajectory = Mapping[str, NDArray[np.float64]]

REST_RAD = 0.02  # what a joint that is held moves by as others stop
MAX_BYTES = 64 * 1024 * 1024  # of a trajectory: an hour of a seven-jointed arm
_LAST = slice(-1, None)  # row


def _read_peak(array: str, rows: slice = slice(None), less: str = "") -> "Callable[[Trajectory], float]":
    """The largest magnitude in some rows of an array, or of its difference from another one."""
    return lambda trajectory: float(abs(trajectory[array] - (trajectory[less] if less else 0.0))[rows].max())


def _read_peak_acceleration(trajectory: "Trajectory") -> float:
    """The largest change of a joint's velocity between two periods, by their distance in time [rad/s2]."""
    import numpy as np

    step_s = np.diff(trajectory["time_s"])[:, None]
    return float((abs(np.diff(trajectory["qd_measured"], axis=0)) / step_s).max())


def _read_rest(trajectory: "Trajectory") -> float:
    """How long at its end every joint was measured within `REST_RAD` of its last place [s]."""
    import numpy as np

    q, time_s = trajectory["q_measured"], trajectory["time_s"]
    (moved,) = np.nonzero(abs(q - q[-1]).max(axis=1) > REST_RAD)
    return float(time_s[-1] - time_s[min(moved[-1] + 1, len(q) - 1) if len(moved) else 0])


TRAJECTORY_METRICS: "Mapping[str, Callable[[Trajectory], float]]" = {
    "final_joint_speed_rad_s": _read_peak("qd_measured", _LAST),
    "final_tracking_error_rad": _read_peak("q_commanded", _LAST, "q_measured"),
    "final_rest_s": _read_rest,
    "final_gripper_width_m": _read_peak("gripper_measured_m", _LAST),
    "peak_joint_speed_rad_s": _read_peak("qd_measured"),
    "peak_joint_acceleration_rad_s2": _read_peak_acceleration,
    "peak_tracking_error_rad": _read_peak("q_commanded", less="q_measured"),
    "peak_force_n": _read_peak("force_n"),
    "peak_force_n_error": _read_peak("force_error_n"),
}
"""Name -> how it is computed from the arrays of the trajectory. `peak_force_n` needs a target that feels contacts and
so records `force_n`, the greatest of each control period; for any other it is unknown."""


def read_report(bundle: Bundle) -> Iterator[tuple[str, float]]:
    """Numbers of the trace and of the outputs, as reported ones, then those that the runtime counted."""
    execution = bundle.execution
    for reported in (*(event.numbers for event in bundle.trace), execution.outputs):
        for name, value in reported.items():
            if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
                yield REPORTED + name, float(value)
    yield "sim_time_s", execution.sim_time_s
    yield "ticks", float(execution.ticks)
    yield "interventions", float(execution.interventions)


def read_course(folder: Path, wanted: set[str]) -> dict[str, float]:
    """Metrics of the recorded trajectory; empty when there is none, or it cannot be read."""
    import numpy as np

    from phyagentos.protocol.workspace.array_files import read_arrays

    path = folder / TRAJECTORY
    try:
        if path.stat().st_size > MAX_BYTES:
            return {}
        trajectory = {name: np.asarray(each, dtype=np.float64) for name, each in read_arrays(path).items()}
    except (OSError, ValueError):
        return {}
    found = {}
    for name in sorted(wanted & TRAJECTORY_METRICS.keys()):
        with contextlib.suppress(KeyError, IndexError, ValueError):  # not recorded, or nothing was commanded
            found[name] = TRAJECTORY_METRICS[name](trajectory)
    return {name: value for name, value in found.items() if math.isfinite(value)}


@dataclass(frozen=True, slots=True)
class MetricJudge:
    """Judges numbers; `criteria` apply to every session, beside the metrics of its own acceptance."""

    criteria: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """`metrics/1`, and the criteria for every session."""
        return f"metrics/1({'; '.join(self.criteria)})" if self.criteria else "metrics/1"

    def judge(self, bundle: Bundle) -> Sequence[Criterion]:
        """One criterion for each predicate about metrics."""
        asked = [("accept", text) for text in bundle.session.accept if has_metric(text)]
        asked += [("metric", text) for text in self.criteria]
        metrics = read_metrics(bundle, {name for _, text in asked for name in iter_metrics(text)})
        return [
            evaluate_criterion(
                text, kind, bundle, metrics, TRAJECTORY if TRAJECTORY_METRICS.keys() & iter_metrics(text) else EXECUTION
            )
            for kind, text in asked
        ]


def read_metrics(bundle: Bundle, wanted: set[str]) -> Mapping[str, float]:
    """The wanted metrics in the bundle; the trajectory is read only when one of them needs it."""
    wanted = wanted | {f"{name}_error" for name in wanted}
    found = dict(read_report(bundle))
    if wanted & TRAJECTORY_METRICS.keys():
        found |= read_course(bundle.folder, wanted)
    return {name: value for name, value in found.items() if name in wanted}


@dataclass(frozen=True, slots=True)
class HoldJudge:
    """Judges conditions that had to hold all through, on the worst that was recorded."""

    name: str = "holds/2"

    def judge(self, bundle: Bundle) -> Sequence[Criterion]:
        """One criterion for each predicate of `hold`; unknown without a sample."""
        sampled = {criterion.text: criterion for criterion in bundle.holds}
        return [_judge_hold(text, sampled.get(text), bundle) for text in bundle.session.hold]


def _judge_hold(text: str, sampled: Criterion | None, bundle: Bundle) -> Criterion:
    if sampled is not None and sampled.truth is Truth.FALSE:
        return sampled
    formula = find_formula(text)
    if formula is not None and is_metric_only(Predicate(formula)):  # the last sample may be older than the last spike
        if bundle.execution.is_idle:
            because = f"{bundle.execution.code}: no control period was commanded"
            return Criterion(text=text, kind="hold", truth=Truth.TRUE, evidence=EXECUTION, because=because)
        metrics = read_metrics(bundle, set(iter_metrics(text)))
        return evaluate_criterion(text, "hold", bundle, metrics, evidence=TRAJECTORY)
    return sampled or make_unknown(text, "hold", HOLDS, "it was never sampled")
