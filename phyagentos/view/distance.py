"""How far the world was from a criterion, over the time of a session: computed again from its evidence.

The curve is of the simulated world (`motion.npz`), as the predicate measures it there; dots are what was perceived
before and after. Where one value is unknown, nothing is drawn.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from msgspec.structs import replace

from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.geometry import Pose
from phyagentos.protocol.predicates.predicate import Evaluation, Predicate, parse_predicate
from phyagentos.protocol.predicates.syntax import iter_calls
from phyagentos.protocol.sessions.evidence import MOTION, SCENE_MODEL, Bundle
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.workspace.array_files import read_arrays
from phyagentos.protocol.world.environment import Environment, Status
from phyagentos.protocol.world.truth import Truth
from phyagentos.view.plots import Array, Plot, join_points
from phyagentos.view.quantities import format_measure, list_numbers

SAMPLES = 120  # of the simulated world
_OF_POSES = frozenset(
    ("inside", "on", "above", "at", "centred", "near", "upright", "fallen", "moved", "tilt", "height", "distance")
)  # predicates that poses alone decide
_ROOM = 0.08  # above and below all values
_FITS = 1e-3  # of the range: deviation of a quantity that margins are proportional to
Sample = tuple[float, Evaluation]


def draw_distance(bundle: Bundle, criterion: Criterion) -> Plot | None:
    """None where the record does not say it; raises ExecutionError `EVIDENCE_DAMAGED`, OSError, ValueError, KeyError."""
    predicate = _parse(criterion.text)
    if predicate is None or bundle.before is None:
        return None
    seen = [
        (world.time_s, predicate.evaluate(bundle.session.make_view(world, bundle.before)))
        for world in (bundle.before, bundle.after)
        if world is not None
    ]
    course = list(_iter_simulated(bundle, bundle.before, predicate))
    known = [each for each in (*course, *seen) if each[1].truth is not Truth.UNKNOWN]
    if len(known) < 2:
        return None
    name, values, limit = _measure([evaluation for _, evaluation in known])
    times = np.array([time_s for time_s, _ in known])
    split = len(known) - sum(evaluation.truth is not Truth.UNKNOWN for _, evaluation in seen)
    first_s, last_s = float(times.min()), float(times.max())
    low, high = min(values.min(), limit), max(values.max(), limit)
    room = _ROOM * max(high - low, 1e-9)
    across = 100 * (times - first_s) / max(last_s - first_s, 1e-9)
    height = 100 - 100 * (values - low + room) / (high - low + 2 * room)
    limit_height = 100 - 100 * (limit - low + room) / (high - low + 2 * room)
    is_met = known[int(np.argmax(values))][1].truth is Truth.TRUE or limit >= values.max()
    period_s = (course[-1][0] - course[0][0]) / (len(course) - 1) if len(course) > 1 else 0.0
    parts = np.split(np.arange(split), np.flatnonzero(np.diff(times[:split]) > 1.5 * period_s) + 1)
    ends = " to ".join(format_measure(float(each), name) for each in (values.min(), values.max()))
    moments = f"simulated at {split} moments, perceived at {len(known) - split}"
    return Plot(
        criterion.text,
        (),
        tuple(join_points(10 * across, height, part) for part in parts if len(part) > 1),
        ((round(float(limit_height), 2), f"limit {format_measure(limit, name)}"),),
        f"{ends}; {moments}; met {'above' if is_met else 'below'} the limit",
        (first_s, last_s),
        tuple(
            (round(float(across[index]), 2), round(float(height[index]), 2), f"perceived: {known[index][1].because}")
            for index in range(split, len(known))
        ),
    )


def _parse(text: str) -> Predicate | None:
    """A predicate that poses decide; None of others, and of text that is none."""
    try:
        predicate = parse_predicate(text)
    except DefinitionError:
        return None
    calls = [each.name for each in iter_calls(predicate.formula)]
    return predicate if calls and _OF_POSES.issuperset(calls) else None


def _iter_simulated(bundle: Bundle, before: Environment, predicate: Predicate) -> Iterator[Sample]:
    """Moments of the simulated world, evenly over those that were recorded; none of another target."""
    import mujoco

    if not all((bundle.folder / name).is_file() for name in (MOTION, SCENE_MODEL)):
        return
    try:
        model = mujoco.MjModel.from_binary_path(str(bundle.folder / SCENE_MODEL))
    except mujoco.FatalError as error:
        raise ExecutionError("EVIDENCE_DAMAGED", f"{bundle.folder}: {error}") from error
    data, moved = mujoco.MjData(model), read_arrays(bundle.folder / MOTION)
    bodies = {
        name: body
        for name, each in before.entities.items()
        if each.movable and (body := mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)) >= 0
    }
    for row in np.unique(np.linspace(0, len(moved["time_s"]) - 1, SAMPLES).astype(int)):
        time_s, data.qpos[:] = float(moved["time_s"][row]), moved["qpos"][row]
        mujoco.mj_kinematics(model, data)
        poses = {
            name: Pose(tuple(data.xpos[body].tolist()), tuple(data.xquat[body].tolist()))
            for name, body in bodies.items()
        }
        known = {
            "observed_at_s": time_s,
            "still_since_s": None,
            "visible": True,
            "status": Status.SEEN,
            "confidence": 1.0,
            "held_by": "",
        }
        entities = {
            name: replace(each, pose=poses.get(name, each.pose), **known) for name, each in before.entities.items()
        }
        now = replace(before, time_s=time_s, sensing="truth", entities=entities, targets={}, sensors={})
        yield time_s, predicate.evaluate(bundle.session.make_view(now, before))


def _measure(evaluations: Sequence[Evaluation]) -> tuple[str, Array, float]:
    """What stands for the distance: name of a quantity, its values, and the value at which the criterion turns over.

    A quantity that was measured where its limit follows from the margins, else the margins themselves: without unit,
    in tolerances.
    """
    margins = np.array([each.margin for each in evaluations])
    least = [
        min(list_numbers(each.measured).items(), key=lambda pair: pair[1], default=("", np.nan)) for each in evaluations
    ]
    values = np.array([value for _, value in least])
    units = {name.rpartition("_")[2] for name, _ in least}
    if len(units) == 1 and np.isfinite(values).all():
        if np.ptp(margins) > 0:
            slope, limit = np.polyfit(margins, values, 1)
            if np.abs(slope * margins + limit - values).max() <= _FITS * max(np.ptp(values), 1e-2):
                return least[0][0], values, float(limit)
        if np.array_equal(values >= 0, margins >= 0):
            return least[0][0], values, 0.0
    return "", margins, 0.0
