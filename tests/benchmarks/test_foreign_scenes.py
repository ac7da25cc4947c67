"""What a scene file of a foreign world says: shapes and looks, and not where objects are that cameras must find."""

import numpy as np
import pytest
import yaml

from benchmarks.libero_parts.bddl import read_places
from benchmarks.libero_parts.foreign_scenes import Seen, write_scene
from benchmarks.libero_parts.tasks import find_areas
from phyagentos.protocol.world.environment import Entity, Interior, Mechanism, Pose, Shape, ShapeKind
from phyagentos.protocol.world.scenes import SceneSpec
from phyagentos.runtime.perception.inventory import build_inventory

BOX = (Shape(ShapeKind.BOX, (0.02, 0.03, 0.04)),)
SLIDE = Mechanism("slide", (0.0, -1.0, 0.0), 0.2, Pose((0.5, 0.3, 0.1)), opens_at=0.6, closes_at=0.05)
ROOM = Interior((0.0, 0.0, 0.0), (0.1, 0.1, 0.05))
OBJECTS = [
    Entity(name="gem", kind="stone", pose=Pose((0.123, 0.456, 0.789)), shapes=BOX, datum_m=(0.0, 0.0, 0.0)),
    Entity(name="desk", kind="fixture", pose=Pose((0.7, 0.0, -0.1)), shapes=BOX, movable=False),
    Entity(name="knob", kind="handle", pose=Pose((0.5, 0.3, 0.1)), shapes=BOX, part_of="tray"),
    Entity(name="tray", kind="part", pose=Pose((0.5, 0.2, 0.1)), shapes=BOX, mechanism=SLIDE, joint=0.5, interior=ROOM),
]
MARKS = {"left_half": {"entity": "desk", "center_m": [0.0, 0.1, 0.05], "half_m": [0.1, 0.05, 0.02]}}
LOOK = [[(0.8, 0.1, 0.1, 1.0)]]


def write(seen):
    text = write_scene("s", "", OBJECTS, MARKS, seen)
    return text, SceneSpec.model_validate(yaml.safe_load(text))


def test_it_does_not_tell_where_free_objects_are_or_how_far_a_joint_is_open():
    text, spec = write(Seen(looks={"gem": LOOK, "tray": LOOK}))

    assert "0.123" not in text
    assert "0.456" not in text
    joint = spec.bodies["tray"].joint
    assert joint.opening == (0.0, 1.0)
    assert (joint.opens_at, joint.closes_at) == (0.6, 0.05)
    assert spec.bodies["tray"].place.position_m == (0.5, 0.3, 0.1), "closed, not as it stands"
    assert spec.bodies["desk"].place.position_m == (0.7, 0.0, -0.1), "the map is known"


def test_what_may_be_anywhere_is_in_the_way_of_nothing_whatever_is_drawn():
    """Two objects were drawn into each other at one height, and a task was refused before it began."""
    crowd = [Entity(name=f"gem{number}", kind="stone", pose=Pose(), shapes=BOX) for number in range(30)]
    spec = SceneSpec.model_validate(yaml.safe_load(write_scene("s", "", [*OBJECTS, *crowd], MARKS, Seen())))

    heights = [body.place.position_m[2] for body in spec.bodies.values() if body.place.area]
    assert len(heights) == len(set(heights)) == 31


def test_perception_is_told_what_is_seen_and_planning_only_what_touches():
    cover = Shape(ShapeKind.BOX, (0.01, 0.01, 0.001), Pose((0.0, 0.0, 0.05)))
    _, spec = write(Seen(looks={"gem": LOOK, "tray": LOOK}, covers={"gem": [cover]}, stand=BOX))
    inventory = build_inventory(spec)

    gem, knob = inventory.objects["gem"], inventory.objects["knob"]
    assert (len(gem.solids.kinds), len(gem.template.shapes)) == (2, 1)
    assert gem.template.datum_m == (0.0, 0.0, 0.0)
    assert np.array_equal(gem.look[0], LOOK[0])
    assert (len(knob.solids.kinds), len(knob.template.shapes)) == (2, 1), "all that moves with it shows it"
    assert inventory.articulated["tray"].mechanism.opens_at == 0.6
    assert inventory.known["stand"].shapes == ()
    assert set(inventory.map_parts) == {"desk", "stand"}
    assert [(each.name, each.body) for each in inventory.regions] == [("left_half", "desk")]


PROBLEM = """(define (problem p) (:objects ruby_1 ruby_2 opal - stone)
  (:init (On ruby_1 left_half) (On ruby_2 opal) (On opal right_half) (Open tray)) (:goal (And (On opal ruby_1))))"""


def test_of_equal_objects_the_problem_tells_which_begins_where():
    assert read_places(PROBLEM) == {"ruby_1": "left_half", "ruby_2": "opal", "opal": "right_half"}
    region = {"pose": {"position_m": [0.5, 0.1, 0.0]}, "half_m": [0.1, 0.02, 0.01]}
    other = {"pose": {"position_m": [0.5, -0.4, 0.0]}, "half_m": [0.1, 0.02, 0.01]}
    kinds = {"ruby_1": "ruby", "ruby_2": "ruby", "opal": "opal"}
    told = {
        "goal": PROBLEM,
        "regions": [region | {"name": "left_half"}, other | {"name": "right_half"}],
        "entities": [{"name": name, "kind": kind} for name, kind in kinds.items()],
    }

    areas = find_areas(told)

    assert set(areas) == {"ruby_1", "ruby_2"}, "what looks like nothing else needs no place"
    assert np.array(areas["ruby_1"]) == pytest.approx(np.array([(0.4, 0.6), (0.08, 0.12)]))
    assert np.array(areas["ruby_2"]) == pytest.approx(np.array([(0.4, 0.6), (-0.42, -0.38)]))
