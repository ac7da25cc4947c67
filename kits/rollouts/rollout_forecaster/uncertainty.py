"""Distributions of the unknown properties of a world, all stated here, each with its reason.

The inventory's declared spans come first; without one, objects have small spans around theirs. How a payload hangs in
the fingers is no draw of its own: it follows from where the object was when they closed.
"""

import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.geometry import convert_euler, multiply
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.world.environment import Entity, Environment
from phyagentos.protocol.world.scenes import Body, SceneSpec
from phyagentos.protocol.world.seeds import compute_seed
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.models.robot import GRIPPER_ACTUATOR, name_actuator
from rollout_forecaster.estimate import Array

POSITION_STD_M = {"truth": 0.0005, "perceived": 0.002}  # where the estimate states none: what a depth camera leaves
TURN_STD_RAD = {"truth": 0.004, "perceived": 0.03}  # an edge of 4 cm whose end is seen 1 mm askew is turned by 0.03 rad
CALIBRATION_STD_M = {"truth": 0.0, "perceived": 0.001}  # of the cameras: moves everything alike
CONFIDENCE_MIN = 0.25  # an object seen this badly is placed four times worse than one seen well; not more
MASS_SHARE = 0.10  # a label gives the nominal mass; contents and wear change it by a tenth
FRICTION_SHARE = 0.20  # between handbook values of the same pair of dry materials
PAD_SHARE = 0.15  # rubber pads wear and take up dust
FORCE_SHARE = 0.10  # of a gripper that controls its force by motor current
STIFFNESS_SHARE = 0.05  # of the arm's servos


@dataclass(frozen=True, slots=True)
class ImaginedStart:
    """A world that agrees with the estimate: a model with its own weights, and its mjSTATE_FULLPHYSICS."""

    model: mujoco.MjModel
    state: Array


def draw_start(
    physics: Physics,
    start: Array,
    spec: SceneSpec,
    environment: Environment,
    profile: TargetProfile,
    *,
    seed: int,
    number: int,
) -> ImaginedStart:
    """Draw one of the worlds around an estimate at rest (mjSTATE_INTEGRATION); the model of `physics` is copied.

    The same seed gives the same worlds, each by its number alone.
    """
    rng = np.random.default_rng(compute_seed(seed, "lookahead", number))
    model = copy.copy(physics.model)
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, start, mujoco.mjtState.mjSTATE_INTEGRATION)
    _draw_robot(model, profile, rng)
    _draw_objects(model, data, spec, environment, _find_pads(model, profile), rng)
    state = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    mujoco.mj_setConst(model, data)  # what follows from the masses; it uses the data as scratch
    return ImaginedStart(model, state)


def _draw_robot(model: mujoco.MjModel, profile: TargetProfile, rng: np.random.Generator) -> None:
    grip = model.actuator(GRIPPER_ACTUATOR).id
    force = 1.0 + FORCE_SHARE * rng.uniform(-1.0, 1.0)
    model.actuator_forcerange[grip] *= force
    for joint in profile.arm.joints[profile.servoed]:
        servo = model.actuator(name_actuator(joint)).id
        gain = 1.0 + STIFFNESS_SHARE * rng.uniform(-1.0, 1.0)
        model.actuator_gainprm[servo, 0] *= gain
        model.actuator_biasprm[servo, 1] *= gain
    _scale_friction(model, _find_pads(model, profile), 1.0 + PAD_SHARE * rng.uniform(-1.0, 1.0))


def _draw_objects(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    spec: SceneSpec,
    environment: Environment,
    pads: NDArray[np.intp],
    rng: np.random.Generator,
) -> None:
    shift = rng.normal(0.0, 1.0, 2) * CALIBRATION_STD_M[environment.sensing]
    for name, body in spec.bodies.items():
        place, shares, ranks = rng.normal(0.0, 1.0, 3), rng.uniform(-1.0, 1.0, 2), rng.uniform(0.0, 1.0, 2)
        entity = environment.entities.get(name)
        if entity is None or body.fixed:
            continue
        if entity.held_by is None:  # what is held is where the fingers are
            _displace(model, data, name, place * _compute_deviation(entity, environment.sensing), shift)
        _weigh(model, name, body, pads, shares, ranks)


def _compute_deviation(entity: Entity, sensing: str) -> Array:
    """(3,) standard deviations of x, y [m] and yaw [rad] of one object."""
    uncertainty = 1.0 / max(entity.confidence, CONFIDENCE_MIN)
    place_m = entity.position_std_m or uncertainty * POSITION_STD_M[sensing]
    turn_rad = entity.turn_std_rad or uncertainty * TURN_STD_RAD[sensing]
    return np.array([place_m, place_m, turn_rad])


def _displace(model: mujoco.MjModel, data: mujoco.MjData, name: str, offset: Array, shift: Array) -> None:
    """Move along the ground and turn about the vertical: height and tilt follow from the support."""
    start = int(model.jnt_qposadr[model.body(name).jntadr[0]])
    data.qpos[start : start + 2] += offset[:2] + shift
    data.qpos[start + 3 : start + 7] = multiply(convert_euler((0.0, 0.0, offset[2])), data.qpos[start + 3 : start + 7])


def _weigh(model: mujoco.MjModel, name: str, body: Body, pads: NDArray[np.intp], shares: Array, ranks: Array) -> None:
    """Mass and friction of one object; a declared span of friction is that against the `pads`, where they make pairs.

    `shares` (2,) in -1..1 scale the nominal ones without a declared span; `ranks` (2,) in 0..1 are places in its spans.
    """
    index = model.body(name).id
    nominal = float(model.body_mass[index])
    mass = nominal * (1.0 + MASS_SHARE * shares[0])
    if body.mass_span_kg is not None:
        mass = body.mass_span_kg[0] + ranks[0] * (body.mass_span_kg[1] - body.mass_span_kg[0])
    model.body_mass[index] = mass
    model.body_inertia[index] *= mass / nominal
    geoms = np.flatnonzero(model.geom_bodyid == index)
    if body.grip_span is None:
        _scale_friction(model, geoms, 1.0 + FRICTION_SHARE * shares[1], slide=True)
        return
    friction = body.grip_span[0] + ranks[1] * (body.grip_span[1] - body.grip_span[0])
    pairs = _find_pairs(model, geoms) & _find_pairs(model, pads)
    if pairs.any():
        model.pair_friction[pairs, :3] *= (friction / model.pair_friction[pairs, 0])[:, None]
    else:
        model.geom_friction[geoms, :2] *= (friction / model.geom_friction[geoms, 0])[:, None]


def _scale_friction(model: mujoco.MjModel, geoms: NDArray[np.intp], factor: float, *, slide: bool = False) -> None:
    """Scale the friction of geoms and of the pairs that they are in; `slide` leaves spin and roll."""
    pairs = _find_pairs(model, geoms)
    model.geom_friction[geoms, : 1 if slide else 3] *= factor
    model.pair_friction[pairs, : 2 if slide else 5] *= factor


def _find_pads(model: mujoco.MjModel, profile: TargetProfile) -> NDArray[np.intp]:
    """Geoms of the finger pads."""
    return np.array([model.geom(pad).id for pad in profile.gripper.pads], dtype=np.intp)


def _find_pairs(model: mujoco.MjModel, geoms: NDArray[np.intp]) -> NDArray[np.bool_]:
    """(n_pairs,) whether any of the geoms is in a pair."""
    found: NDArray[np.bool_] = np.isin(model.pair_geom1, geoms) | np.isin(model.pair_geom2, geoms)
    return found
