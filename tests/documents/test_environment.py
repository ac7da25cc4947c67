"""ENVIRONMENT.md tells where objects are, by the same predicates as verdicts."""

import msgspec
import pytest

from phyagentos.errors import DefinitionError
from phyagentos.protocol.predicates.relations import RELATIONS_MAX, compute_relations
from phyagentos.protocol.world.environment import (
    Change,
    Entity,
    Environment,
    Interior,
    Pose,
    Region,
    SensorHealth,
    Shape,
    ShapeKind,
    TargetState,
    read_environment,
)
from phyagentos.store.views.environment import render_environment

CUBE = (Shape(kind=ShapeKind.BOX, size_m=(0.02, 0.02, 0.02)),)
ENVIRONMENT = Environment(
    time_s=12.5,
    scene="tabletop/cubes_and_trays",
    episode="tidy-7",
    revision=3,
    sensing="truth",
    entities={
        "table": Entity(
            name="table",
            kind="table",
            pose=Pose((0.5, 0.0, 0.38)),
            shapes=(Shape(kind=ShapeKind.BOX, size_m=(0.5, 0.5, 0.02)),),
            movable=False,
        ),
        "red_tray": Entity(
            name="red_tray",
            kind="tray",
            pose=Pose((0.5, 0.1, 0.4)),
            interior=Interior(center_m=(0, 0, 0.03), half_m=(0.1, 0.1, 0.03)),
            movable=False,
        ),
        "red_cube": Entity(
            name="red_cube", kind="cube", color="red", pose=Pose((0.5, 0.1, 0.42)), shapes=CUBE, observed_at_s=12.5
        ),
        "blue_cube": Entity(
            name="blue_cube", kind="cube", pose=Pose((0.2, 0.2, 0.6)), shapes=CUBE, held_by="panda", observed_at_s=12.5
        ),
        "free_cube": Entity(
            name="free_cube", kind="cube", pose=Pose((0.3, -0.3, 0.42)), shapes=CUBE, observed_at_s=12.5
        ),
        "lost_cube": Entity(
            name="lost_cube", kind="cube", pose=Pose((0.3, 0.3, 0.42)), shapes=CUBE, visible=False, observed_at_s=1.0
        ),
    },
    regions={"shelf": Region(name="shelf", pose=Pose((1.0, 0.0, 0.5)), half_m=(0.1, 0.2, 0.3))},
    targets={
        "panda": TargetState(
            q_rad=(0.1,) * 7, qd_rad_s=(0.0,) * 7, gripper_width_m=0.0397, tcp=Pose(), holding=("blue_cube",)
        )
    },
)


def test_the_environment_tells_where_objects_are():
    text = render_environment(ENVIRONMENT)

    for line in (
        "| red_cube | red cube | inside red_tray | 0.500 0.100 0.420 |",
        "| blue_cube | cube | held by panda |",
        "| free_cube | cube | on table |",
        "| lost_cube | cube | unknown | 0.300 0.300 0.420 | 0.000 | 0.000 | no | 1.000 |",
        "| table | table | fixed |",
        "| shelf | 1.000 0.000 0.500 | 0.100 0.200 0.300 |",
        "| panda | 0.000 0.000 0.000 | 0.0397 | blue_cube |",
    ):
        assert line in text
    relations = read_environment(text).relations
    assert [relation.text for relation in relations] == [
        "inside(red_cube, red_tray)",
        "holding(panda, blue_cube)",
        "on(free_cube, table)",
    ]
    assert relations[0].measured["below_rim_m"] > 0
    assert relations[2].observed_at_s == 12.5


def test_two_snapshots_differ_in_the_lines_that_changed():
    moved = msgspec.structs.replace(ENVIRONMENT.entities["red_cube"], visible=False)
    later = msgspec.structs.replace(ENVIRONMENT, entities=ENVIRONMENT.entities | {"red_cube": moved})
    before, after = (render_environment(each).splitlines() for each in (ENVIRONMENT, later))

    changed = sorted(set(after) - set(before))

    assert [line.split()[0] for line in changed] == ['"red_cube":', "|"]
    assert changed[1].startswith("| red_cube |")


def test_an_environment_that_nobody_observed_says_so():
    text = render_environment(None)
    assert "Nothing has been observed yet." in text
    with pytest.raises(DefinitionError, match=r"ENVIRONMENT.md:1:1: NOT_OBSERVED.*at the end of its first session"):
        read_environment(text)


def test_a_snapshot_that_is_damaged_names_the_line():
    text = render_environment(ENVIRONMENT)
    line = text.split("time_s: 12.5")[0].count("\n") + 1
    with pytest.raises(DefinitionError, match=rf"E.md:{line}:1: INVALID_VALUE: found 'noon'; expected a number"):
        read_environment(text.replace("time_s: 12.5", "time_s: noon"), "E.md")


def test_relations_carry_what_was_measured_and_how_old_it_is():
    near = msgspec.structs.replace(
        ENVIRONMENT.entities["free_cube"], name="next_cube", pose=Pose((0.3, -0.22, 0.42)), source="rgbd"
    )
    drawer = Entity(name="drawer", kind="drawer", pose=Pose((0.9, 0.9, 0.4)), movable=False, joint=0.95)
    more = ENVIRONMENT.entities | {"next_cube": near, "drawer": drawer}

    found = {each.text: each for each in compute_relations(msgspec.structs.replace(ENVIRONMENT, entities=more))}

    assert found["near(free_cube, next_cube)"].measured["distance_m"] == pytest.approx(0.08)
    assert found["left_of(next_cube, free_cube)"].measured == {"aside_m": 0.08}
    assert found["on(next_cube, table)"].source == "rgbd"
    assert found["holding(panda, blue_cube)"].measured == {"gripper_width_m": 0.0397}
    assert "open(drawer)" in found
    assert not [text for text in found if "lost_cube" in text]


def test_what_changed_and_how_the_cameras_do_is_told():
    told = msgspec.structs.replace(
        ENVIRONMENT,
        changes=(Change(entity="red_cube", what="moved", by_m=0.25), Change(entity="blue_cube", what="held")),
        sensors={"left": SensorHealth(status="frozen", time_s=4.2, detail="a new stamp on the same picture")},
    )

    text = render_environment(told)

    assert "- **Since the snapshot before:** red_cube moved by 0.250 m, blue_cube held" in text
    assert "| left | frozen | 4.200 | a new stamp on the same picture |" in text
    assert read_environment(text).changes == told.changes


@pytest.mark.slow
def test_a_crowd_does_not_make_the_document_grow_without_bound():
    crowd = {
        f"cube_{index}": msgspec.structs.replace(
            ENVIRONMENT.entities["free_cube"],
            name=f"cube_{index}",
            pose=Pose((0.3 + 0.03 * (index % 8), 0.03 * (index // 8), 0.42)),
        )
        for index in range(64)
    }

    relations = compute_relations(
        msgspec.structs.replace(ENVIRONMENT, entities={"table": ENVIRONMENT.entities["table"]} | crowd)
    )

    assert len(relations) == RELATIONS_MAX
    assert [each.name for each in relations[:64]] == ["on"] * 64
