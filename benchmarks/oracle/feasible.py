"""Whether a goal can be met at all: reach, opening, free volume and friction, by arithmetic on the generator's room.

No perception, no planner, no code of the package. It says *infeasible* where a bound of the hardware or of geometry
is broken for certain; whatever it cannot decide counts as feasible. Numbers are those of the arm's data sheet.
"""

import math
import re
from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks.worlds.cases import Case, Node
from benchmarks.worlds.rooms import Room, SceneObject, find_twin

REACH_M = 0.90  # level distance of a fingertip from the base: 0.70 to the wrist, then flange and hand laid flat
OPENING_M = 0.080
FORCE_N = 70.0  # of a finger, at most
PAYLOAD_KG = 3.0 - 0.73  # of the arm, less the hand that hangs on it
LIFTING = frozenset({"pick_and_place", "pick", "stack", "set_aside"})
ROUND_TOPS = frozenset({"ball", "rod"})


def list_obstacles(case: Case, node: Node) -> list[str]:
    """Why a node cannot be met by any skill of this arm; empty where it may be."""
    if node.is_claim:
        return list(_iter_contradictions(node.accept))
    item = case.room.objects[str(node.arguments["object"])]
    found = list(_iter_reach(case.room, item, node))
    if node.skill in LIFTING:
        found += _iter_grasp(item)
    place = case.room.objects.get(str(node.arguments.get("destination", node.arguments.get("support", ""))))
    if place is not None and node.skill == "pick_and_place":
        found += _iter_volume(case, item, place)
    if place is not None and node.skill == "stack" and place.form.kind in ROUND_TOPS:
        found.append(f"{place.name} has no level top: what stands on one point or line falls")
    return found + list(_iter_contradictions(node.accept))


def find_contradiction(case: Case) -> str:
    """What makes the nodes that move something contradict each other, whatever is done; empty where nothing does."""
    return next(_iter_contradictions([text for node in case.nodes if not node.is_claim for text in node.accept]), "")


def find_ambiguity(case: Case, node: Node) -> str:
    """An object that no look tells from one that the node names: equal in form and colour; empty where there is none.

    Whether such a node can be met is not decided here: no look tells which of the two the name means, unless the goal
    lets them stand for each other.
    """
    agreed = {name for names in case.interchangeable for name in names}
    named = set(re.findall(r"\w+", " ".join((*node.accept, *map(str, node.arguments.values())))))
    for name in sorted((named & set(case.room.objects)) - agreed):
        if (twin := find_twin(case.room, case.room.objects[name])) is not None:
            return f"{name} looks as {twin.name} does"
    return ""


def _iter_reach(room: Room, item: SceneObject, node: Node) -> Iterator[str]:
    ends = {item.name: item.at_m}
    for key in ("destination", "support", "to"):
        value = node.arguments.get(key)
        if isinstance(value, list):
            ends[key] = (float(value[0]), float(value[1]), float(value[2]))
        elif isinstance(value, str) and value in room.objects:
            ends[value] = room.objects[value].at_m
    for name, (x, y, _) in ends.items():
        if math.hypot(x, y) > REACH_M:
            yield f"{name} is {math.hypot(x, y):.2f} m from the base, the hand reaches {REACH_M} m"


def _iter_grasp(item: SceneObject) -> Iterator[str]:
    if item.form.grip_m > OPENING_M:
        yield f"{item.name} is at least {1e3 * item.form.grip_m:.0f} mm wide, the hand opens {1e3 * OPENING_M:.0f} mm"
    if item.mass_kg > PAYLOAD_KG:
        yield f"{item.name} weighs {item.mass_kg:.1f} kg, the arm carries {PAYLOAD_KG} kg"
    hold_n, weight_n = 2 * FORCE_N * item.grip[1], 9.81 * item.mass_kg
    if weight_n > hold_n and item.form.kind not in {"mug", "bowl"}:  # those may hang on a rim or a handle
        yield f"{item.name} weighs {weight_n:.1f} N, friction of both fingers bears {hold_n:.1f} N"


def _iter_volume(case: Case, item: SceneObject, vessel: SceneObject) -> Iterator[str]:
    if vessel.form.interior is None:
        return
    sides = sorted(float(side) for side in item.form.span_m)
    inner = sorted(2 * side for side in vessel.form.interior[1][:2])
    sinks = item.form.kind == "ball"  # between the walls, as far as nothing fills them
    if not sinks and (sides[0] > inner[0] or sides[1] > math.hypot(*inner)):
        told = " x ".join(f"{1e3 * side:.0f}" for side in sides)
        free = " x ".join(f"{1e3 * side:.0f}" for side in inner)
        yield f"{item.name} ({told} mm) does not go into {vessel.name} ({free} mm)"
    if not sinks:
        yield from _iter_crowd(case, vessel)
    for block in case.room.movable:
        if block.on == vessel.name and block.form.grip_m > OPENING_M and block.name != item.name:
            left = 2 * np.array(vessel.form.interior[1][:2]) - block.form.span_m[:2]
            if block.yaw_rad == vessel.yaw_rad and left.max() < sides[0]:
                yield f"{vessel.name} is filled by {block.name}, which no hand takes out"


def _iter_crowd(case: Case, vessel: SceneObject) -> Iterator[str]:
    """Everything that is put into a vessel too shallow for two layers, each on its smallest face."""
    assert vessel.form.interior is not None
    _, (x, y, z) = vessel.form.interior
    put = {str(n.arguments["object"]) for n in case.nodes if n.arguments.get("destination") == vessel.name}
    sides = [sorted(float(side) for side in case.room.objects[name].form.span_m) for name in sorted(put)]
    area = sum(np.pi / 4 * each[0] * each[1] for each in sides)  # a round object takes no more of its square
    if all(each[0] > 2 * z for each in sides) and area > 4 * x * y:
        yield f"{', '.join(sorted(put))} have no room in {vessel.name}: {1e4 * area:.0f} of {4e4 * x * y:.0f} cm2"


def _iter_contradictions(texts: Sequence[str]) -> Iterator[str]:
    """An object is not in two vessels at once."""
    where: dict[str, str] = {}
    for text in texts:
        if found := re.fullmatch(r"inside\((\w+), (\w+)\)", text):
            other = where.setdefault(found[1], found[2])
            if other != found[2] and "spot" not in {other, found[2]}:
                yield f"{found[1]} cannot be in {other} and in {found[2]}"
