"""How far the world was from a criterion, over the time of a session: computed again from its evidence.

The curve is of the simulated world (`motion.npz`), as the predicate measures it there; dots are what was perceived
before and after. A moment of which the value is unknown is left out.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from msgspec.structs import replace

from phyagentos.geometry import Pose
from phyagentos.pictures.playback import Array, Playback
from phyagentos.protocol.predicates.evaluation import Evaluation, evaluate
from phyagentos.protocol.predicates.library import ArgumentKind, Meaning, get_predicate_library
from phyagentos.protocol.predicates.predicate import find_formula
from phyagentos.protocol.predicates.syntax import iter_calls
from phyagentos.protocol.sessions.evidence import Bundle
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.world.environment import FRESH_S, Environment, Status
from phyagentos.protocol.world.truth import Truth
from phyagentos.view.quantities import list_numbers

SAMPLES = 120  # of the simulated world
_OF_MORE = (Meaning.CONTAINS, Meaning.OPEN, Meaning.CLOSED)  # that poses of objects alone do not decide
_ARGUMENTS = {ArgumentKind.ENTITY, ArgumentKind.CONTAINER, ArgumentKind.PLACE, ArgumentKind.NUMBER}
_FITS = 1e-3  # of the range: by which a quantity may differ from one that the margins are proportional to
Sample = tuple[float, float, str]
"""Simulated time [s], value, and the finding in words."""


@dataclass(frozen=True, slots=True)
class Distance:
    """Values of a `quantity` (empty: tolerances) over time; the criterion is met above the limit, or below it."""

    text: str
    quantity: str
    limit: float
    is_met_above: bool
    simulated: list[Sample]
    perceived: list[Sample]


def read_distance(bundle: Bundle, criterion: Criterion, playback: Playback | None) -> Distance | None:
    """None where the record does not say it: too few known moments, or a predicate that poses do not decide."""
    formula, before = find_formula(criterion.text), bundle.before
    calls = {each.name for each in iter_calls(formula)} if formula is not None else set()
    if formula is None or before is None or not calls or not all(map(_is_of_poses, calls)):
        return None
    simulated = _iter_simulated(playback, before) if playback is not None else ()
    worlds = [
        *((each, True) for each in simulated),
        (before, False),
        *([(bundle.after, False)] if bundle.after else []),
    ]
    found = [(*each, evaluate(formula, bundle.session.make_view(each[0], before))) for each in worlds]
    known = [each for each in found if each[2].truth is not Truth.UNKNOWN]
    if len(known) < 2:
        return None
    quantity, values, limit = _measure([each for _, _, each in known])
    samples = [(now.time_s, float(value), each.because) for (now, _, each), value in zip(known, values, strict=True)]
    split = sum(is_simulated for _, is_simulated, _ in known)
    best = int(np.argmax(np.abs(values - limit)))
    is_met_above = (values[best] > limit) == (known[best][2].truth is Truth.TRUE)
    return Distance(criterion.text, quantity, limit, bool(is_met_above), samples[:split], samples[split:])


def _is_of_poses(name: str) -> bool:
    """Whether the poses of objects alone decide a predicate; a momentary one, as of a speed, needs more."""
    found = get_predicate_library().find(name)
    if found is None or found.by_name or found.meaning in _OF_MORE or found.max_age_s < FRESH_S:
        return False
    return bool(found.arguments) and _ARGUMENTS.issuperset(each.kind for each in found.arguments)


def _iter_simulated(playback: Playback, before: Environment) -> Iterator[Environment]:
    """The simulated world, evenly over the moments that were recorded; what stands fixed is where it was perceived."""
    data, movable = (
        mujoco.MjData(playback.model),
        {name: each for name, each in before.entities.items() if each.movable},
    )
    bodies = {name: mujoco.mj_name2id(playback.model, mujoco.mjtObj.mjOBJ_BODY, name) for name in movable}
    for time_s in playback.time_s[np.unique(np.linspace(0, len(playback.time_s) - 1, SAMPLES).astype(int))].tolist():
        playback.pose(time_s, data)
        moved = {
            name: replace(
                movable[name], pose=Pose(tuple(data.xpos[body].tolist()), tuple(data.xquat[body].tolist())),
                observed_at_s=time_s, still_since_s=None, visible=True, status=Status.SEEN, confidence=1.0, held_by="",
            )
            for name, body in bodies.items() if body >= 0
        }  # fmt: skip
        yield replace(before, time_s=time_s, sensing="truth", entities=before.entities | moved, targets={}, sensors={})


def _measure(evaluations: Sequence[Evaluation]) -> tuple[str, Array, float]:
    """What stands for the distance: name of a quantity, its values, and the value at which the criterion turns over.

    A quantity that was measured where its limit follows from the margins, else the margins themselves: without unit,
    in tolerances.
    """
    margins = np.array([each.margin for each in evaluations])
    numbers = [list_numbers(each.measured) or {"": np.nan} for each in evaluations]
    values, names = (
        np.array([min(each.values()) for each in numbers]),
        [min(each, key=each.__getitem__) for each in numbers],
    )
    if len({name.rpartition("_")[2] for name in names}) == 1 and np.isfinite(values).all():
        slope, limit = np.polyfit(margins, values, 1) if np.ptp(margins) > 0 else (0.0, 0.0)
        if np.abs(slope * margins + limit - values).max() <= _FITS * max(np.ptp(values), 1e-2):
            return names[0], values, float(limit)
        if np.array_equal(values >= 0, margins >= 0):
            return names[0], values, 0.0
    return "", margins, 0.0
