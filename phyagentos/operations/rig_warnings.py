"""What the cameras of a rig cannot tell of a goal: bodies that none sees, sizes and distances below what they resolve.

An estimate at best: nothing hides anything, and each body stands where its nearest camera sees it.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from phyagentos.agent.goals.graph import GoalGraph
from phyagentos.errors import Problem, format_names
from phyagentos.protocol.documents.schema import Address, Located
from phyagentos.protocol.predicates import syntax
from phyagentos.protocol.predicates.builtins import DOUBT_STDS
from phyagentos.protocol.predicates.library import get_predicate_library
from phyagentos.protocol.predicates.predicate import find_entities, find_formula
from phyagentos.protocol.settings.sensors import WORLD, NoiseLevel, Sensors
from phyagentos.protocol.world.alike import ALIKE_M, find_alike
from phyagentos.protocol.world.scenes import Body, SceneSpec
from phyagentos.runtime.perception.pose_uncertainty import BIAS_M, BIAS_PER_M, RESIDUAL_M
from phyagentos.wording import compare_lengths, format_length

LENGTHS = frozenset({"tol_m", "distance_m"})  # names of arguments of predicates that say how near is near


@dataclass(frozen=True, slots=True)
class _StandingCamera:
    name: str
    position_m: np.ndarray
    target_m: np.ndarray
    half_rad: float  # from the axis to a corner of the picture
    range_m: tuple[float, float]

    def measure(self, point_m: np.ndarray, radius_m: float) -> float:
        """Distance [m] to a body that it sees; infinite to one out of its picture."""
        ahead, to = self.target_m - self.position_m, point_m - self.position_m
        away_m = float(np.linalg.norm(to))
        aside_rad = math.acos(min(1.0, float(ahead @ to) / (float(np.linalg.norm(ahead)) * max(away_m, 1e-9))))
        is_in = aside_rad - math.atan2(radius_m, away_m) < self.half_rad
        return away_m if is_in and self.range_m[0] < away_m + radius_m < self.range_m[1] + radius_m else math.inf


class Rig:
    """Standing cameras before a scene."""

    def __init__(self, scene: SceneSpec, sensors: Sensors) -> None:
        self.scene, self._noise = scene, sensors.get_noise()
        self.cameras = [*_iter_standing(scene, sensors)]
        self._away_m: dict[str, float] = {}

    def measure(self, name: str) -> float:
        """Distance of a body to the nearest camera that may see it [m]; infinite where none does."""
        if name not in self._away_m:
            places, radius_m = self._list_places(name), _measure_radius(self.scene.bodies[name])
            seen = (each.measure(place, radius_m) for each in self.cameras for place in places)
            self._away_m[name] = min(seen, default=math.inf)
        return self._away_m[name]

    def estimate_std(self, name: str) -> float:
        """Standard deviation of its measured place at best [m]; 0 of what the scene file places, or none sees."""
        body = self.scene.bodies[name]
        if math.isinf(away_m := self.measure(name)) or (body.fixed and not any(body.place.jitter_m)):
            return 0.0
        return BIAS_M + BIAS_PER_M * max(_estimate_depth(self._noise, away_m), RESIDUAL_M) ** 2

    def _list_places(self, name: str) -> list[np.ndarray]:
        """Corners of where it may stand, and the middle."""
        body = self.scene.bodies[name]
        place, area = body.place, self.scene.areas.get(body.place.area or "")
        before = body.part_of or place.frame
        own = np.array(place.position_m)
        reach, middle = np.array(place.jitter_m), own
        if area is not None:
            spans = np.array([area.x_m, area.y_m])
            middle = np.array([*spans.mean(axis=1), own[2]])
            reach = np.array([*np.ptp(spans, axis=1) / 2, reach[2]])
        around = [middle + reach * signs for signs in itertools.product((-1, 0, 1), repeat=3)]
        return [at + each for at in self._list_places(before) for each in around] if before else around


def iter_rig_warnings(graph: GoalGraph, located: Located, rig: Rig) -> Iterator[Problem]:
    """One warning for each body, and each criterion, that this rig cannot decide."""
    texts: dict[Address, str] = {("accept", index): text for index, text in enumerate(graph.spec.accept)}
    for node in graph.nodes.values():
        texts |= {(*node.path, "accept", index): text for index, text in enumerate(node.spec.accept)}
    named = {name: path for path, text in reversed(texts.items()) for name in find_entities(text)}
    for name, path in reversed(named.items()) if rig.cameras else ():
        if name in rig.scene.bodies:
            yield from _iter_of_body(name, located, path, rig)
    for path, text in texts.items():
        formula = find_formula(text)
        for call in syntax.iter_calls(formula) if formula is not None else ():
            yield from _iter_of_call(call, located, path, rig)


def _iter_of_body(name: str, located: Located, path: Address, rig: Rig) -> Iterator[Problem]:
    if math.isinf(rig.measure(name)):
        hint = "Move it, or place a camera in sensors.yaml; a camera on a hand looks only where that reaches."
        seeing = f"a place in view of one of {format_names([each.name for each in rig.cameras])}"
        yield located.problem("NOT_OBSERVED", path, f"{name!r}, which no standing camera sees", seeing, hint)
    apart_m = max(DOUBT_STDS * math.sqrt(2.0) * rig.estimate_std(name), ALIKE_M)
    if others := find_alike(rig.scene, name, apart_m) - find_alike(rig.scene, name):
        found = f"{name!r}, which has the colours of {format_names(others)} and sides that differ by less than"
        hint = "Give one of them another colour, or a size that differs by more."
        found = f"{found} {format_length(apart_m)}, which is what these cameras resolve"
        yield located.problem("ALIKE", path, found, "an object that differs from the others", hint)


def _iter_of_call(call: syntax.Call, located: Located, path: Address, rig: Rig) -> Iterator[Problem]:
    definition = get_predicate_library().find(call.name)
    stds = {
        t.text: rig.estimate_std(t.text)
        for t in call.terms
        if isinstance(t, syntax.Name) and t.text in rig.scene.bodies
    }
    doubt_m = DOUBT_STDS * math.hypot(*stds.values())
    for argument, term in zip(definition.arguments if definition else (), call.terms, strict=False):
        if argument.name in LENGTHS and isinstance(term, syntax.Number) and term.value <= doubt_m:
            asked, least = compare_lengths(term.value, doubt_m)
            hint = f"Write more than {doubt_m:.2g}, or place a camera nearer in sensors.yaml."
            found = f"{asked} in {syntax.render(call)!r}"
            expected = f"more than ±{least}, as well as these cameras place {' and '.join(stds)} at best"
            yield located.problem("UNDECIDABLE", path, found, expected, hint)


def _iter_standing(scene: SceneSpec, sensors: Sensors) -> Iterator[_StandingCamera]:
    for name, sensor in sensors.cameras.items():
        settings = sensor.camera
        if settings is None or settings.mount != WORLD:
            continue
        shown = scene.cameras.get(settings.scene_camera) if settings.scene_camera else settings
        if shown is None or shown.position_m is None or shown.target_m is None:
            continue
        fovy_deg = settings.fovy_deg or getattr(shown, "fovy_deg", None)
        tall = math.tan(math.radians(fovy_deg) / 2) if fovy_deg else settings.height / (2 * (settings.fy or 1.0))
        half_rad = math.atan(math.hypot(tall, tall * settings.width / settings.height))
        yield _StandingCamera(name, np.array(shown.position_m), np.array(shown.target_m), half_rad, settings.range_m)


def _measure_radius(body: Body) -> float:
    return max(math.hypot(*solid.position_m) + math.hypot(*solid.size_m) for solid in body.shapes)


def _estimate_depth(noise: NoiseLevel, away_m: float) -> float:
    """Standard deviation of depth at a distance [m]."""
    return noise.depth_constant_m + noise.depth_quadratic_per_m * (away_m - noise.depth_offset_m) ** 2
