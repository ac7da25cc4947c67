"""Every scene that ships builds, settles and is the same for the same seed; every robot is what its profile says."""

import mujoco
import numpy as np
import pytest

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.world.scenes import Body, SceneSpec, read_scene
from phyagentos.runtime.models.robot import build_robot, name_actuator
from phyagentos.runtime.models.scene import add_scene, draw_bodies
from phyagentos.runtime.targets import wire
from tests.models_here import read_profile_here

pytestmark = pytest.mark.sim

LIBRARY = Library.open()
SCENES = LIBRARY.names_of_scenes()


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("scene", SCENES)
def test_a_scene_settles_with_everything_where_it_was_put(make_rig, scene, seed):
    rig = make_rig()
    assert isinstance(rig.load(seed=seed, scene=scene), wire.Loaded)
    spec = read_scene(LIBRARY.get_scene(scene))
    starts = {item.name: np.array(item.position_m) for item in draw_bodies(spec, seed)}
    for entity in rig.observe().entities:
        assert np.linalg.norm(np.array(entity.pose.position_m) - starts[entity.name]) < 0.02, entity.name
        assert entity.speed_m_s < 0.05, entity.name
    physics = rig.driver.physics
    assert physics.data.contact.dist[: physics.data.ncon].min(initial=0.0) > -0.002
    robot = {physics.model.body(name).id for name in ("link1", "link4", "link7", "hand", "left_finger")}
    touched = physics.model.geom_bodyid[physics.data.contact.geom[: physics.data.ncon]]
    assert not robot & set(touched.ravel().tolist())


@pytest.mark.parametrize("scene", SCENES)
def test_a_seed_makes_the_scene(make_rig, scene):
    rigs = [make_rig() for _ in range(3)]
    hashes = [rig.load(seed=seed, scene=scene).model_sha256 for rig, seed in zip(rigs, (5, 5, 6), strict=True)]
    assert hashes[0] == hashes[1]
    assert hashes[0] != hashes[2]


@pytest.mark.parametrize("target", LIBRARY.names_of_targets())
def test_a_robot_is_what_its_profile_says(target):
    profile, folder = read_profile_here(target)
    model = build_robot(profile, folder).compile()
    for index, joint in list(enumerate(profile.arm.joints))[profile.servoed]:
        servo = model.actuator(name_actuator(joint))
        assert servo.gainprm[0] == profile.arm.stiffness_nm_rad[index]
        assert tuple(servo.forcerange) == (-profile.arm.torque_nm[index], profile.arm.torque_nm[index])
        low, high = model.joint(joint).range
        assert low <= profile.arm.home_rad[index] <= high
    data = mujoco.MjData(model)
    data.qpos[[int(model.joint(name).qposadr[0]) for name in profile.arm.joints]] = profile.arm.home_rad
    mujoco.mj_forward(model, data)
    approach = data.site(profile.tcp).xmat.reshape(3, 3)[:, 2]
    assert approach[2] < -0.99 or profile.base is not None


SCENE_TEXT = """scene: tabletop/test
materials: {wood: {}}
bodies:
  table: {kind: table, fixed: true, material: wod, shapes: [{kind: box, size_m: [1, 1]}]}
  cube: {kind: cube, plaec: {}, shapes: [{kind: box, size_m: [0.02, 0.02, 0.02]}]}
cameras: {}
"""


def test_a_broken_scene_is_told_with_line_and_nearest_name(tmp_path):
    path = tmp_path / "scenes" / "tabletop" / "test.yaml"
    path.parent.mkdir(parents=True)
    path.write_text(SCENE_TEXT)
    with pytest.raises(DefinitionError, match=r"test.yaml:5:\d+: UNKNOWN_NAME \(key\): found 'plaec'") as caught:
        read_scene(path)
    assert "Did you mean 'place'?" in str(caught.value)
    assert "test.yaml:4" in str(caught.value)
    path.write_text(SCENE_TEXT.replace("plaec", "place").replace("[1, 1]", "[1, 1, 1]"))
    with pytest.raises(
        DefinitionError, match=r"test.yaml:4:\d+: UNKNOWN_NAME \(material\): found 'wod'; expected wood"
    ):
        read_scene(path)


def test_solids_and_bodies_of_like_names_are_built_side_by_side():
    solid = {"kind": "box", "size_m": (0.02, 0.02, 0.02)}
    bodies = {name: Body(kind="thing", shapes=(solid,) * 3) for name in ("mug", "mug_2", "mug_2_1", "mug_:2")}
    spec = SceneSpec(scene="s", bodies=bodies, cameras={})
    robot = mujoco.MjSpec()
    add_scene(robot, spec, draw_bodies(spec, 1))
    model = robot.compile()
    names = {model.geom(index).name: model.body(model.geom(index).bodyid[0]).name for index in range(model.ngeom)}
    assert {name: body for name, body in names.items() if name in bodies} == {name: name for name in bodies}
    assert (names["mug_1"], names["mug_::2"], names["mug_2_:1"], names["mug_2_2"]) == ("mug", "mug", "mug_2", "mug_2")


def test_what_is_only_seen_is_fixed():
    """A mark of decor alone has no mass: the world ended with a division by zero."""
    mark = {"kind": "mark", "shapes": ({"kind": "box", "size_m": (0.1, 0.1, 0.001), "decor": True},)}
    spec = SceneSpec(scene="x/y", cameras={}, bodies={"mark": Body.model_validate({**mark, "fixed": True})})
    add_scene(robot := mujoco.MjSpec(), spec, draw_bodies(spec, 0))
    assert not robot.compile().body("mark").mass[0]
    with pytest.raises(ValueError, match="decor alone touches nothing"):
        Body.model_validate(mark)


def test_an_overfull_area_is_told(tmp_path, make_rig):
    spec = read_scene(LIBRARY.get_scene("tabletop/cubes_and_trays"))
    area = spec.areas["start"].model_copy(update={"x_m": (0.4, 0.41), "y_m": (0.0, 0.01)})
    with pytest.raises(Exception, match=r"SCENE_INVALID: .*no room for 'green_cube' in area 'start'"):
        draw_bodies(spec.model_copy(update={"areas": {"start": area}}), 1)


def test_what_a_vessel_holds_is_built_into_it_and_what_it_cannot_hold_is_refused(make_rig):
    rig = make_rig()
    rig.load(seed=3, scene="tabletop/pour")
    held = {entity.name: entity.contents for entity in rig.observe().entities if entity.contents is not None}
    assert {name: (each.least, each.most) for name, each in held.items()} == {"cup": (20, 20), "bowl": (0, 0)}
    cup = read_scene(LIBRARY.get_scene("tabletop/pour")).bodies["cup"].model_dump(mode="json", exclude_none=True)
    with pytest.raises(ValueError, match="the interior has room for 30 of 60 balls"):
        Body.model_validate(cup | {"contents": cup["contents"] | {"count": 60}})


def test_a_ball_that_falls_is_stopped_by_the_floor_of_a_bowl(make_rig):
    rig = make_rig()
    rig.load(seed=3, scene="tabletop/pour")
    physics = rig.driver.physics
    x, y, _ = physics.queries.find_position("bowl")
    for index in range(1, 6):
        physics.data.joint(f"cup.{index}_free").qpos[:3] = (x - 0.045 + 0.015 * index, y, 0.25)
    physics.step(1000)
    physics.queries.look()
    bowl = next(entity for entity in physics.queries.read_entities({}) if entity.name == "bowl")
    assert bowl.contents.least == 5


def test_fingers_that_have_just_closed_upon_each_other_are_nothing_the_arm_would_run_into(make_rig):
    rig = make_rig()
    rig.load()
    physics = rig.driver.physics
    for joint in rig.profile.gripper.joints:
        physics.data.joint(joint).qpos[:] = -0.0005  # they touch and let go with every step of the servo
    assert physics.queries.check_posture(rig.profile.arm.home_rad)[1] == ""
