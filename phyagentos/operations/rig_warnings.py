"""What the cameras of a rig cannot tell of a goal: bodies unseen, or like what they lie on, and sizes too small.

An estimate at best: nothing hides anything, and each body stands where its nearest camera sees it.
"""

import itertools
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from phyagentos.agent.goals.graph import GoalGraph
from phyagentos.errors import Problem, format_names
from phyagentos.protocol.documents.schema import Address, Located
from phyagentos.protocol.predicates import syntax
from phyagentos.protocol.predicates.library import UNCERTAINTY_STDS, get_predicate_library
from phyagentos.protocol.predicates.predicate import find_entities, find_formula
from phyagentos.protocol.settings.sensors import WORLD, CameraSettings, Sensors
from phyagentos.protocol.world.alike import ALIKE_M, find_alike
from phyagentos.protocol.world.entity_geometry import compute_sides
from phyagentos.protocol.world.scenes import SceneSpec
from phyagentos.runtime.perception.inventory import iter_like_map, measure_turning_width
from phyagentos.runtime.perception.pose_uncertainty import BIAS_M, BIAS_PER_M, BIAS_TURN, RESIDUAL_M
from phyagentos.runtime.perception.views import RAISED_M, RAISED_STDS
from phyagentos.wording import compare_angles, compare_lengths, format_length

LENGTHS = frozenset({"tol_m", "distance_m"})  # names of arguments of predicates that say how near is near
NUMBERS = {"m": compare_lengths, "rad": compare_angles}  # of predicates, by unit
REACH_M = 1.0
UNDER, OVER = frozenset({"<", "<="}), frozenset({">", ">="})


class Rig:
    """Standing cameras before a scene."""

    def __init__(self, scene: SceneSpec, sensors: Sensors) -> None:
        self.scene, self._noise = scene, sensors.get_noise()
        standing = {
            name: each.camera for name, each in sensors.cameras.items() if each.camera and each.camera.mount == WORLD
        }
        self.cameras = {
            name: each for name, each in standing.items() if not each.scene_camera or each.scene_camera in scene.cameras
        }

    def measure(self, name: str) -> float:
        """Distance of a body to the nearest camera that may see it [m]; infinite where none does."""
        solids = self.scene.bodies[name].shapes
        radius_m = max(math.hypot(*each.position_m) + math.hypot(*each.size_m) for each in solids)
        ways = itertools.product(self.cameras.values(), self._list_places(name))
        return min((self._look(camera, place, radius_m) for camera, place in ways), default=math.inf)

    def measure_extent(self) -> float:
        """The longest length that can be meant in the scene [m]: its diagonal and the reach of an arm."""
        places = np.array([each for name in self.scene.bodies for each in self._list_places(name)] or [np.zeros(3)])
        return float(np.linalg.norm(np.ptp(places, axis=0))) + REACH_M

    def estimate_std(self, name: str) -> float:
        """Standard deviation of its measured place at best [m]; 0 of what the scene file places, or none sees."""
        body, depth_m = self.scene.bodies[name], self.estimate_depth_std(name)
        if math.isinf(depth_m) or (body.fixed and not any(body.place.jitter_m)):
            return 0.0
        return BIAS_M + BIAS_PER_M * max(depth_m, RESIDUAL_M) ** 2

    def estimate_depth_std(self, name: str) -> float:
        """Standard deviation of a depth in the picture of the nearest camera [m]; infinite of what none sees."""
        away_m, noise = self.measure(name), self._noise
        return noise.depth_constant_m + noise.depth_quadratic_per_m * (away_m - noise.depth_offset_m) ** 2

    def estimate_turn_std(self, name: str) -> float:
        """Standard deviation of how it is measured to lean at best [rad]: its place, as off at its two ends."""
        return BIAS_TURN * self.estimate_std(name) / max(measure_turning_width(self.scene.bodies[name]), 1e-3)

    def _look(self, camera: CameraSettings, point_m: NDArray[np.float64], radius_m: float) -> float:
        """Distance [m] to a body that a camera sees; infinite to one out of its picture."""
        seen = self.scene.cameras[camera.scene_camera] if camera.scene_camera else camera
        at, ahead = np.array(seen.position_m), np.subtract(seen.target_m or point_m, seen.position_m or point_m)
        away_m = float(np.linalg.norm(to := point_m - at))
        aside_rad = math.acos(np.clip(ahead @ to / (np.linalg.norm(ahead) * max(away_m, 1e-9)), -1.0, 1.0))
        tall = camera.height / 2 / camera.fy if camera.fy else math.tan(math.radians(seen.fovy_deg or 0.0) / 2)
        corner_rad = math.atan(tall * math.hypot(1.0, camera.width / camera.height))
        is_in = aside_rad - math.atan2(radius_m, away_m) < corner_rad
        return away_m if is_in and camera.range_m[0] < away_m < camera.range_m[1] + radius_m else math.inf

    def _list_places(self, name: str) -> list[NDArray[np.float64]]:
        """The middle of where a body may stand, and the corners."""
        body = self.scene.bodies[name]
        area, before = self.scene.areas.get(body.place.area or ""), body.part_of or body.place.frame
        middle, reach = np.array(body.place.position_m), np.array(body.place.jitter_m)
        if area is not None:
            middle[:2], reach[:2] = np.mean([area.x_m, area.y_m], axis=1), np.ptp([area.x_m, area.y_m], axis=1) / 2
        around = [middle, *(middle + reach * signs for signs in itertools.product((-1, 1), repeat=3))]
        return [at + each for at in self._list_places(before) for each in around] if before else around


def iter_rig_warnings(graph: GoalGraph, located: Located, rig: Rig) -> Iterator[Problem]:
    """One warning for each body, and each criterion, that this rig cannot decide."""
    texts: dict[Address, str] = {("accept", index): text for index, text in enumerate(graph.spec.accept)}
    for node in graph.nodes.values():
        texts |= {(*node.path, "accept", index): text for index, text in enumerate(node.spec.accept)}
    named = {name: path for path, text in reversed(texts.items()) for name in find_entities(text)}
    for name in reversed([each for each in named if each in rig.scene.bodies and rig.cameras]):
        yield from _iter_of_body(name, located, named[name], rig)
    for body in iter_like_map(rig.scene) if rig.cameras else ():
        thick_m, least_m = compute_sides(body)[0], max(RAISED_M, RAISED_STDS * rig.estimate_depth_std(body.name))
        if thick_m < least_m < math.inf:
            thick, least = compare_lengths(thick_m, least_m)
            found = f"{body.name!r}, {thick} thin and of a hue like what it may lie on: no camera tells them apart"
            hint = "Give it another colour. Until a look has shown it, on() is unknown of what may stand on it."
            expected = f"another hue, or more than {least}"
            yield located.problem("NOT_OBSERVED", named.get(body.name, ("scene",)), found, expected, hint)
    formulas = [(path, formula) for path, text in texts.items() if (formula := find_formula(text)) is not None]
    for path, formula in formulas:
        for part, is_wanted in _iter_parts(formula):
            for call in syntax.iter_calls(part) if is_wanted else ():
                yield from _iter_of_call(call, located, path, rig)
            if isinstance(part, syntax.Compare):
                yield from _iter_of_number(part, UNDER if is_wanted else OVER, located, path, rig)
    yield from _iter_of_bands(formulas, located, rig)


def _iter_parts(formula: syntax.Formula, is_wanted: bool = True) -> Iterator[tuple[syntax.Formula, bool]]:
    """What a criterion consists of, and whether it is to be true."""
    match formula:
        case syntax.Not(body):
            yield from _iter_parts(body, not is_wanted)
        case syntax.And(parts) | syntax.Or(parts):
            for part in parts:
                yield from _iter_parts(part, is_wanted)
        case _:
            yield formula, is_wanted


def _iter_of_body(name: str, located: Located, path: Address, rig: Rig) -> Iterator[Problem]:
    if math.isinf(rig.measure(name)):
        hint = "Move it, or place a camera in sensors.yaml; a camera on a hand looks only where that reaches."
        seeing = f"a place in view of one of {format_names(rig.cameras)}"
        yield located.problem("NOT_OBSERVED", path, f"{name!r}, which no standing camera sees", seeing, hint)
    apart_m = max(UNCERTAINTY_STDS * math.sqrt(2.0) * rig.estimate_std(name), ALIKE_M)
    if others := find_alike(rig.scene, name, apart_m) - find_alike(rig.scene, name):
        sides = f"sides that differ by less than {format_length(apart_m)}, which is what these cameras resolve"
        found = f"{name!r}, which has the colours of {format_names(others)} and {sides}"
        hint = "Give one of them another colour, or a size that differs by more."
        yield located.problem("AMBIGUOUS", path, found, "an object that differs from the others", hint)


def _iter_of_number(
    compared: syntax.Compare, under: frozenset[str], located: Located, path: Address, rig: Rig
) -> Iterator[Problem]:
    """Of what is never below zero no bound within its uncertainty is surely kept; no measured number equals another."""
    names, unit, uncertainty = _estimate(compared.left, rig)
    is_equal = compared.relation == "==" and under is UNDER
    if not isinstance(compared.bound, float):
        return
    if unit == "m":
        yield from _iter_of_length(compared.bound, syntax.render(compared), located, path, rig)
    if not uncertainty:
        return
    if is_equal or (compared.relation in under and compared.bound <= uncertainty):
        limit, least = NUMBERS[unit](compared.bound, uncertainty)
        expected = f"more than ±{least}, as well as these cameras measure {' and '.join(names)} at best"
        wanted = "Compare it with < or >" if is_equal else f"Write more than {uncertainty:.2g}"
        hint = f"{wanted}, or place a camera nearer in sensors.yaml."
        found = f"{compared.relation} {limit} in {syntax.render(compared)!r}"
        yield located.problem("UNDECIDABLE", path, found, expected, hint)


def _iter_of_bands(formulas: list[tuple[Address, syntax.Formula]], located: Located, rig: Rig) -> Iterator[Problem]:
    """Two bounds of one number, of one list of criteria, that are nearer to each other than it is surely measured."""
    bounds: dict[tuple[Address, syntax.Call | syntax.Count], dict[bool, float]] = {}
    for path, formula in formulas:
        for part in formula.parts if isinstance(formula, syntax.And) else (formula,):
            if not isinstance(part, syntax.Compare) or not isinstance(part.bound, float) or part.relation == "==":
                continue
            of = bounds.setdefault((path[:-1], part.left), {})
            of[part.relation in UNDER] = part.bound
            names, unit, uncertainty = _estimate(part.left, rig)
            if uncertainty and len(of) == 2 and of[True] - of[False] <= 2 * uncertainty:
                apart, least = NUMBERS[unit](of[True] - of[False], 2 * uncertainty)
                found = f"{apart} between the bounds of {syntax.render(part.left)!r}"
                expected = f"more than {least}, as well as these cameras measure {' and '.join(names)} at best"
                hint = "Move the bounds apart, or place a camera nearer in sensors.yaml."
                yield located.problem("UNDECIDABLE", path, found, expected, hint)


def _estimate(measured: syntax.Call | syntax.Count, rig: Rig) -> tuple[list[str], str, float]:
    """The bodies of a measured number, its unit, and how far it may be off at best; 0 where that is not known."""
    definition = get_predicate_library().find(measured.name) if isinstance(measured, syntax.Call) else None
    if definition is None or definition.unit not in NUMBERS or not isinstance(measured, syntax.Call):
        return [], "", 0.0
    names = [each.text for each in measured.terms if isinstance(each, syntax.Name) and each.text in rig.scene.bodies]
    estimate = rig.estimate_turn_std if definition.unit == "rad" else rig.estimate_std
    return names, definition.unit, UNCERTAINTY_STDS * math.hypot(*map(estimate, names))


def _iter_of_call(call: syntax.Call, located: Located, path: Address, rig: Rig) -> Iterator[Problem]:
    names = [each.text for each in call.terms if isinstance(each, syntax.Name) and each.text in rig.scene.bodies]
    uncertainty_m = UNCERTAINTY_STDS * math.hypot(*map(rig.estimate_std, names))
    definition = get_predicate_library().find(call.name)
    for argument, term in zip(definition.arguments if definition else (), call.terms, strict=False):
        if argument.name not in LENGTHS or not isinstance(term, syntax.Number):
            continue
        yield from _iter_of_length(term.value, syntax.render(call), located, path, rig)
        if term.value <= uncertainty_m:
            tolerance, least = compare_lengths(term.value, uncertainty_m)
            expected = f"more than ±{least}, as well as these cameras place {' and '.join(names)} at best"
            hint = f"Write more than {uncertainty_m:.2g}, or place a camera nearer in sensors.yaml."
            yield located.problem("UNDECIDABLE", path, f"{tolerance} in {syntax.render(call)!r}", expected, hint)


def _iter_of_length(length_m: float, text: str, located: Located, path: Address, rig: Rig) -> Iterator[Problem]:
    """A length beyond all that the scene holds, which decides nothing: mostly of another unit."""
    if length_m > (extent_m := rig.measure_extent()):
        found, expected = f"{length_m:g} m in {text!r}", f"a length within the scene, {extent_m:.1f} m"
        yield located.problem("INVALID_VALUE", path, found, expected, f"For centimetres write {length_m / 100:g}.")
