"""The imagined world: the scene's inventory at the poses of the estimate.

What an episode's seed decides (poses, weights, friction) is never read: poses and shapes come from the estimate, weight
and grip are the middle of the declared spans.
"""

from collections.abc import Callable

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from typing_extensions import override

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.world.descriptions import add_described
from phyagentos.protocol.world.environment import Entity, Environment, Shape, Status
from phyagentos.protocol.world.friction import FRICTION, PAIRS
from phyagentos.protocol.world.scenes import Body, Placement, SceneSpec, Solid
from phyagentos.runtime.drivers.mujoco.faults import FaultInjector
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.drivers.mujoco.world import SimulatedWorld
from phyagentos.runtime.lookahead.resolve_penetration import stand_up_sunk

Array = NDArray[np.float64]

SETTLE_S = 0.3  # of simulated time, within which a thing a millimetre inside its support comes to rest


class BelievedWorld(SimulatedWorld):
    """A world whose one scene is the estimate."""

    def __init__(self, library: Library, believed: SceneSpec, faults: Callable[[str, int], FaultInjector]) -> None:
        super().__init__(library, faults=faults)
        self._believed = believed

    @override
    def find_scene(self, name: str) -> SceneSpec:
        return self._believed


def believe_scene(spec: SceneSpec, environment: Environment) -> SceneSpec:
    """The scene as believed: what is not in the estimate, or gone, is left out."""
    spec = add_described(spec, environment.entities)
    bodies = {
        name: _believe_body(body, environment.entities[name])
        for name, body in spec.bodies.items()
        if name in environment.entities and environment.entities[name].status is not Status.GONE
    }
    regions = {name: region for name, region in spec.regions.items() if region.body is None or region.body in bodies}
    friction = {pair: _center(spec.friction.get(pair, FRICTION[pair])) for pair in PAIRS}
    return spec.model_copy(update={"bodies": bodies, "regions": regions, "friction": friction})


def _believe_body(body: Body, entity: Entity) -> Body:
    w, _, _, z = entity.pose.quaternion_wxyz
    yaw = 2.0 * float(np.arctan2(z, w))
    return body.model_copy(
        update={
            "place": Placement(position_m=entity.pose.position_m, yaw_rad=(yaw, yaw)),
            "shapes": tuple(map(_believe_shape, entity.shapes)) or body.shapes,  # else nothing was measured
            "stretch_z": None,
            "contents": None if entity.contents is not None and not entity.contents.most else body.contents,
            "mass_span_kg": body.mass_span_kg and _center(body.mass_span_kg),
            "grip_span": body.grip_span and _center(body.grip_span),
        }
    )


def _believe_shape(shape: Shape) -> Solid:
    w, x, y, z = shape.pose.quaternion_wxyz
    euler_rad = (0.0, 0.0, 0.0)
    if (w, x, y, z) != (1.0, 0.0, 0.0, 0.0):
        roll, pitch, yaw = Rotation.from_quat((x, y, z, w)).as_euler("XYZ").tolist()
        euler_rad = (roll, pitch, yaw)
    return Solid(kind=shape.kind, size_m=shape.size_m, position_m=shape.pose.position_m, euler_rad=euler_rad)


def _center(span: tuple[float, float]) -> tuple[float, float]:
    """The middle of a span, as one."""
    return (0.5 * (span[0] + span[1]),) * 2


def settle_estimate(physics: Physics, environment: Environment, profile: TargetProfile) -> Array:
    """Put everything at its believed pose, without penetrations, and let it come to rest.

    Returns the mjSTATE_INTEGRATION vector of the world at rest; the state of `physics` is written.
    """
    model, data, target = physics.model, physics.data, environment.targets[profile.target]
    mujoco.mj_resetData(model, data)
    physics.place_at_home()
    physics.write_posture(data, np.array(target.q_rad))
    loose = []
    for joint in range(model.njnt):
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            name = model.body(int(model.jnt_bodyid[joint])).name
            if name not in environment.entities:
                continue  # balls in their vessel, and a base
            pose = environment.entities[name].pose
            start = int(model.jnt_qposadr[joint])
            data.qpos[start : start + 7] = (*pose.position_m, *pose.quaternion_wxyz)
            loose += [name] if environment.entities[name].held_by is None else []
    width_m = float(np.clip(target.gripper_width_m, 0.0, profile.gripper.max_width_m))
    hand = physics.scene.hands[profile.target]
    for finger, position in zip(hand.joints, hand.pose(width_m), strict=True):
        data.qpos[model.joint(finger).qposadr[0]] = position
    stand_up_sunk(model, data, loose)
    command_m = 0.0 if target.holding else width_m
    q = np.asarray(target.q_rad, dtype=np.float64)
    physics.set_servos(q, np.zeros_like(q), command_m)
    physics.step(round(SETTLE_S / model.opt.timestep))
    return physics.read_state()
