"""Friction by pairs of surfaces, and round objects that come to rest."""

import mujoco
import numpy as np
import pytest

from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.settings.sensors import read_sensors
from phyagentos.protocol.world.friction import FRICTION, PAIRS
from phyagentos.protocol.world.idealisations import format_idealisations
from phyagentos.protocol.world.scenes import SceneSpec
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.drivers.mujoco.world import MujocoDriver, SimulatedWorld
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.models.surfaces import find_idealised
from phyagentos.runtime.models.world import compile_scene
from phyagentos.runtime.targets import wire

PANDA = read_profile(find_shipped_root() / "robots" / "panda" / "target.yaml")


def make_object(kind, size, y, z, material="plastic", **more):
    shape = {"kind": kind, "size_m": size, "euler_rad": [np.pi / 2, 0, 0] if kind != "box" else [0, 0, 0]}
    place = {"position_m": [0.5, y, z]}
    return {"kind": kind, "material": material, "shapes": [shape], "place": place, "mass_kg": 0.1} | more


def make_scene(**bodies):
    table = {"kind": "table", "fixed": True, "material": "wood", "place": {"position_m": [0.5, 0, -0.02]}}
    table["shapes"] = [{"kind": "box", "size_m": [0.6, 0.6, 0.02]}]
    materials = {name: {"surface": name} for name in ("wood", "plastic", "card")} | {"unknown": {}}
    data = {"scene": "t", "cameras": {}, "materials": materials, "bodies": {"table": table, **bodies}}
    return SceneSpec.model_validate(data)


@pytest.fixture(scope="module")
def still():
    """A model with a ball, a lying can, a rod and boxes on a table, and the data at rest."""
    spec = make_scene(
        ball=make_object("sphere", [0.02], -0.2, 0.02),
        can=make_object("cylinder", [0.03, 0.05], 0.0, 0.03),
        rod=make_object("capsule", [0.01, 0.05], 0.15, 0.01),
        box=make_object("box", [0.02, 0.02, 0.02], 0.3, 0.02),
        carton=make_object("box", [0.02, 0.02, 0.02], 0.4, 0.02, "card", grip_span=[0.07, 0.07]),
        lump=make_object("box", [0.02, 0.02, 0.02], -0.4, 0.02, "unknown"),
    )
    model = compile_scene((PANDA,), spec, 3).model
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 100)
    return model, data


def find_friction(model, one, other):
    """Sliding friction of the contact that MuJoCo makes of two touching geoms."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    names = {model.geom(one).id, model.geom(other).id}
    return next(float(c.friction[0]) for c in data.contact if set(c.geom.tolist()) == names)


@pytest.mark.parametrize(("item", "pair"), [("box", "plastic|wood"), ("carton", "card|wood"), ("ball", "plastic|wood")])
def test_a_contact_has_the_friction_of_its_pair(still, item, pair):
    low, high = FRICTION[pair]

    assert low <= find_friction(still[0], item, "table") <= high


def test_without_a_surface_an_object_keeps_an_ideal_friction_and_is_named(still):
    spec = make_scene(lump=make_object("box", [0.02] * 3, 0, 0.02, "unknown"), box=make_object("box", [0.02] * 3, 1, 1))

    assert find_friction(still[0], "lump", "table") == 1.0
    assert find_idealised(spec) == ["lump"]


def test_a_declared_grip_holds_against_the_pads_alone(still):
    model, pad = still[0], still[0].geom("left_pad").id
    carton = model.geom("carton").id
    pairs = {
        frozenset((int(a), int(b))): f[0]
        for a, b, f in zip(model.pair_geom1, model.pair_geom2, model.pair_friction, strict=True)
    }

    assert pairs[frozenset((carton, pad))] == pytest.approx(0.07)
    assert pairs[frozenset((carton, model.geom("table").id))] >= 0.4


def test_a_light_object_is_not_pressed_into_what_it_lies_on():
    """A rod of 10 g lay three centimetres deep in the table, and a slab of 20 g below the floor of a tray."""
    rod = make_object("capsule", [0.0075, 0.025], 0.15, 0.0075, mass_kg=0.01)
    model = compile_scene((PANDA,), make_scene(rod=rod), 3).model
    data, body = mujoco.MjData(model), model.body("rod").id

    for press_n in np.linspace(0.0, 60.0, 500).tolist():  # as fingers that come down on it
        data.xfrc_applied[body, 2] = -press_n
        mujoco.mj_step(model, data)

    assert data.xpos[body, 2] == pytest.approx(0.0075, abs=0.004)


def test_round_objects_that_roll_come_to_rest(still):
    model, data = still
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 100)
    radii = {"ball": 0.02, "can": 0.03, "rod": 0.01}
    for name, radius in radii.items():
        dof = model.jnt_dofadr[model.body(name).jntadr[0]]
        data.qvel[dof] = 0.1
        data.qvel[dof + 3 : dof + 6] = data.body(name).xmat.reshape(3, 3).T @ (0, 0.1 / radius, 0)
    begun = {name: float(data.body(name).xpos[0]) for name in radii}
    mujoco.mj_step(model, data, 600)

    for name in radii:
        dof = model.jnt_dofadr[model.body(name).jntadr[0]]
        assert np.abs(data.qvel[dof : dof + 6]).max() < 0.01
        assert 0.01 < data.body(name).xpos[0] - begun[name] < 0.15


def test_the_table_has_every_pair_between_two_and_six_tenths():
    assert set(FRICTION) == set(PAIRS)
    assert all(0.2 <= low < high <= 0.6 for low, high in FRICTION.values())


def test_a_scene_refuses_a_pair_that_there_is_not():
    with pytest.raises(ValueError, match="wax"):
        SceneSpec.model_validate({"scene": "t", "cameras": {}, "bodies": {}, "friction": {"wax|wood": [0.1, 0.1]}})


@pytest.mark.parametrize("material", ["plastic", "unknown"])
def test_pads_that_slip_hold_nothing_whatever_decides_the_grip(material):
    """A slip had no effect on an object without a surface whose own friction is above that of the pads."""
    item = make_object("box", [0.02, 0.02, 0.02], 0.0, 0.3, material, grip_span=[0.5, 0.5])
    physics = Physics.alone(*PANDA, make_scene(item=item), 3)
    model, data = physics.model, physics.data
    pads = [geom for geom in range(model.ngeom) if "pad" in (model.geom(geom).name or "")]
    own = model.geom("item").id
    mujoco.mj_forward(model, data)
    address = int(model.joint(model.body("item").jntadr[0]).qposadr[0])
    data.qpos[address : address + 3] = data.geom_xpos[pads[0]]  # one pad is within the object

    def find_frictions():
        mujoco.mj_forward(model, data)
        return [float(c.friction[0]) for c in data.contact if own in c.geom and set(c.geom.tolist()) & set(pads)]

    assert max(find_frictions()) == pytest.approx(0.5)
    physics.actuation.set_pad_friction((0.01, 0.0005, 0.0001))
    assert max(find_frictions()) == pytest.approx(0.01)
    physics.actuation.set_pad_friction(None)
    assert max(find_frictions()) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("scene", "level", "changes", "named"),
    [
        ("tabletop/cubes_and_trays", "nominal", {}, ""),
        ("tabletop/waiter", "nominal", {}, "friction (coin)"),
        ("tabletop/cubes_and_trays", "none", {}, "cameras (noise level none)"),
        ("tabletop/cubes_and_trays", "nominal", {"force_bias_n": 0.0}, "contact_force"),
    ],
)
def test_a_target_names_what_is_idealised(library, panda, scene, level, changes, named):
    profile, folder = panda
    sensors = read_sensors(find_shipped_root() / "protocol" / "sensors.yaml").model_copy(update={"noise_level": level})
    driver = MujocoDriver(SimulatedWorld(library, sensors=sensors), profile.model_copy(update=changes), folder)
    driver.load(wire.LoadScene(scene=scene, seed=1, episode="e"))

    assert format_idealisations(driver.describe().idealisations) == named
