"""How often what is stated is true: errors of stated numbers in units of their stated deviations."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.perception_parts.stage import Stage
from benchmarks.worlds.rooms import Thing
from phyagentos.geometry import compute_rotation, compute_rotation_vector
from phyagentos.protocol.world.environment import Entity, Environment, Status
from phyagentos.runtime.perception.forms import Form
from phyagentos.runtime.perception.inventory import ObjectModel
from phyagentos.runtime.perception.unknown_objects import is_unknown_object

STRANGER_M = 0.06  # from a body that has no name: the stranger is that body
SIDES = ("first", "second", "height")
Array = np.ndarray


@dataclass(frozen=True, slots=True)
class Stated:
    """One number as it is stated, against the truth.

    Attributes:
        number: Which, as `thing x`.
        error: Its distance to the truth, in its own unit.
        std: Its stated standard deviation.
        what: Whose it is, to find it again.
    """

    number: str
    error: float
    std: float
    what: str

    def is_within(self, deviations: float) -> bool:
        """Whether the truth is so near; a number without doubt is stated as exact."""
        return self.error <= deviations * self.std


def compare(stage: Stage, belief: Environment, unnamed: dict[str, Thing]) -> Iterator[Stated]:
    """Every number of a belief that states a doubt, against the world."""
    inventory, where = stage.pipeline.inventory, f"{stage.world.name}:{stage.world.seed}"
    for name, thing in inventory.things.items():
        entity = belief.entities.get(name)
        if entity is None or entity.status is not Status.SEEN or thing.vessel is not None:
            continue
        names = (name, *entity.alternatives)
        body = min(names, key=lambda each: np.linalg.norm(stage.world.find(each)[0] - entity.pose.position_m))
        group = "thing" if thing.template.movable else "fixed"
        yield from _compare_pose(group, entity, thing, *stage.world.find(body), f"{where} {name}")
    for name, jointed in inventory.articulated.items():
        entity = belief.entities.get(name)
        if entity is not None and entity.status is Status.SEEN and entity.joint is not None:
            error = abs(entity.joint * jointed.mechanism.travel - stage.world.find_opening(name))
            is_hinge = jointed.mechanism.kind == "hinge"
            std = entity.turn_std_rad if is_hinge else entity.position_std_m
            yield Stated("angle of a door" if is_hinge else "opening of a drawer", error, std, f"{where} {name}")
    for entity in belief.entities.values():
        if is_unknown_object(entity.name) and entity.status is Status.SEEN:
            yield from _compare_stranger(stage, entity, unnamed, where)


def _compare_pose(
    group: str, entity: Entity, thing: ObjectModel, position: Array, rotation: Array, what: str
) -> Iterator[Stated]:
    for axis, error in zip("xyz", np.abs(np.array(entity.pose.position_m) - position).tolist(), strict=True):
        yield Stated(f"{group} {axis}", error, entity.position_std_m, what)
    if thing.form is Form.BALL:
        return
    believed = compute_rotation(entity.pose.quaternion_wxyz)
    alike = [*thing.symmetries, *(turned for turned, _ in thing.lookalikes)]
    tilt = _tilt(rotation)
    tilts = [abs(_tilt(believed @ each) - tilt) for each in thing.symmetries]
    yield Stated(f"{group} tilt", min(tilts), entity.tilt_std_rad, what)
    if thing.form is Form.ROUND:
        return
    turns = [compute_rotation_vector(believed @ each @ rotation.T) for each in alike]
    yield Stated(f"{group} yaw", abs(float(min(turns, key=np.linalg.norm)[2])), entity.turn_std_rad, what)


def _tilt(rotation: Array) -> float:
    return float(np.arccos(np.clip(rotation[2, 2], -1.0, 1.0)))


def _compare_stranger(stage: Stage, entity: Entity, unnamed: dict[str, Thing], where: str) -> Iterator[Stated]:
    """A box of unknown form, against the box around the body that it is."""
    places = {name: stage.world.find(name) for name in unnamed}
    at = np.array(entity.pose.position_m)
    name = min(places, key=lambda each: np.linalg.norm(places[each][0] - at), default="")
    if not name or np.linalg.norm(places[name][0] - at) > STRANGER_M:
        return
    position, rotation = places[name]
    if abs(rotation[2, 2]) < 0.999:
        return  # its box is not the one that it was drawn as
    what = f"{where} {name}"
    for axis, error in zip("xyz", np.abs(at - position).tolist(), strict=True):
        yield Stated(f"stranger {axis}", error, entity.position_std_m, what)
    half = np.array(entity.shapes[0].size_m)
    true = np.array(unnamed[name].form.span_m) / 2
    stated = [*sorted(half[:2]), half[2]]
    for side, one, other in zip(SIDES, stated, [*sorted(true[:2]), true[2]], strict=True):
        yield Stated(f"stranger {side} size", 2 * abs(float(one - other)), entity.size_std_m, what)
