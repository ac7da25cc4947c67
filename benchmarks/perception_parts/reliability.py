"""How often what is stated is true: errors of stated numbers in units of their stated deviations."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from benchmarks.perception_parts.stage import Stage
from benchmarks.worlds.rooms import SceneObject
from phyagentos.geometry import compute_rotation, compute_rotation_vector, turn
from phyagentos.protocol.world.environment import Entity, Environment, Status
from phyagentos.runtime.perception.forms import Form
from phyagentos.runtime.perception.inventory import ObjectModel
from phyagentos.runtime.perception.unknown_objects import is_unknown_object

STRANGER_M = 0.06  # from a body that has no name: the stranger is that body
SIDES = ("first", "second", "height")
ROLLS = 180  # turns about the axis of a round body
Array = np.ndarray


@dataclass(frozen=True, slots=True)
class Stated:
    """One number as it is stated, against the truth.

    Attributes:
        number: Which, as `object x`.
        error: Its distance to the truth, in its own unit.
        std: Its stated standard deviation.
        what: Whose it is, to find it again.
        kind: Of that body.
    """

    number: str
    error: float
    std: float
    what: str
    kind: str

    def is_within(self, deviations: float) -> bool:
        """Whether the truth is so near; a number without uncertainty is stated as exact."""
        return self.error <= deviations * self.std


def compare(stage: Stage, belief: Environment, unnamed: dict[str, SceneObject]) -> Iterator[Stated]:
    """Every number of a belief that states an uncertainty, against the world."""
    inventory, where = stage.pipeline.inventory, f"{stage.world.name}:{stage.world.seed}"
    for name in stage.displaced:
        if (entity := belief.entities.get(name)) is not None and name in inventory.known:
            alone = [(np.eye(3), np.zeros(3))]
            stated = _compare_pose("map", entity, Form.FIXED, alone, *stage.world.find(name), where)
            yield from (each for each in stated if each.number in {"map z", "map tilt"})  # the others are the map's own
    for name, item in inventory.objects.items():
        entity = belief.entities.get(name)
        if entity is None or entity.status is not Status.SEEN or item.vessel is not None:
            continue
        names = (name, *entity.alternatives)
        body = min(names, key=lambda each: np.linalg.norm(stage.world.find(each)[0] - entity.pose.position_m))
        group = "thing" if item.template.movable else "fixed"
        yield from _compare_pose(group, entity, item.form, list(_iter_alike(item)), *stage.world.find(body), where)
    for name, jointed in inventory.articulated.items():
        entity = belief.entities.get(name)
        if entity is not None and entity.status is Status.SEEN and entity.joint is not None:
            error = abs(entity.joint * jointed.mechanism.travel - stage.world.find_opening(name))
            is_hinge = jointed.mechanism.kind == "hinge"
            std = entity.turn_std_rad if is_hinge else entity.position_std_m
            number = "angle of a door" if is_hinge else "opening of a drawer"
            yield Stated(number, error, std, f"{where} {name}", entity.kind)
    for entity in belief.entities.values():
        if is_unknown_object(entity.name) and entity.status is Status.SEEN:
            yield from _compare_stranger(stage, entity, unnamed, where)


def _compare_pose(
    group: str,
    entity: Entity,
    form: Form,
    alike: Sequence[tuple[Array, Array]],
    position: Array,
    rotation: Array,
    where: str,
) -> Iterator[Stated]:
    what, believed = (f"{where} {entity.name}", entity.kind), compute_rotation(entity.pose.quaternion_wxyz)
    turns = [compute_rotation_vector(believed @ turned @ rotation.T) for turned, _ in alike]
    nearest = int(np.argmin(np.linalg.norm(turns, axis=1))) if form in {Form.BOX, Form.FIXED} else 0
    turned, shift = alike[nearest]
    at = entity.pose.position_m + believed @ shift
    for axis, error in zip("xyz", np.abs(at - position).tolist(), strict=True):
        yield Stated(f"{group} {axis}", error, entity.position_std_m, *what)
    if form is Form.BALL:
        return
    yield Stated(f"{group} tilt", abs(_tilt(believed @ turned) - _tilt(rotation)), entity.tilt_std_rad, *what)
    if form is not Form.ROUND:
        yield Stated(f"{group} yaw", abs(float(turns[nearest][2])), entity.turn_std_rad, *what)


def _iter_alike(item: ObjectModel) -> Iterator[tuple[Array, Array]]:
    """Turns (3, 3) with shifts (3,) of a body that no look tells apart: first none, then those of its form."""
    yield np.eye(3), np.zeros(3)
    rolled = [np.eye(3)]
    if item.form is Form.BOX and item.turns.shape[1] == 2:
        axis = np.cross(*item.turns.T)
        rolled = [turn(axis * angle) for angle in np.linspace(0.0, 2 * np.pi, ROLLS, endpoint=False)]
    for same, roll in product(item.symmetries, rolled):
        yield same @ roll, np.zeros(3)
        yield from ((same @ turned @ roll, same @ shift) for turned, shift in item.lookalikes)


def _tilt(rotation: Array) -> float:
    return float(np.arccos(np.clip(rotation[2, 2], -1.0, 1.0)))


def _compare_stranger(stage: Stage, entity: Entity, unnamed: dict[str, SceneObject], where: str) -> Iterator[Stated]:
    """A box of unknown form, against the box around the body that it is."""
    places = {name: stage.world.find(name) for name in unnamed}
    at = np.array(entity.pose.position_m)
    name = min(places, key=lambda each: np.linalg.norm(places[each][0] - at), default="")
    if not name or np.linalg.norm(places[name][0] - at) > STRANGER_M:
        return
    position, rotation = places[name]
    if abs(rotation[2, 2]) < 0.999:
        return  # its box is not the one that it was drawn as
    what = f"{where} {name}", unnamed[name].form.kind
    for axis, error in zip("xyz", np.abs(at - position).tolist(), strict=True):
        yield Stated(f"stranger {axis}", error, entity.position_std_m, *what)
    half = np.array(entity.shapes[0].size_m)
    true = np.array(unnamed[name].form.span_m) / 2
    stated = [*sorted(half[:2]), half[2]]
    for side, one, other in zip(SIDES, stated, [*sorted(true[:2]), true[2]], strict=True):
        yield Stated(f"stranger {side} size", 2 * abs(float(one - other)), entity.size_std_m, *what)
