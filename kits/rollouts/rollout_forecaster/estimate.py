"""The imagined world: the scene's inventory at the poses of the estimate.

What an episode's seed decides (poses, weights, friction) is never read: poses and shapes come from the estimate, weight
and grip are the middle of the declared spans. Penetrations are resolved before simulation, for a solver would throw
such a body away. A small object that lies and one that stands on its rim look nearly alike, but only one of both fits
between its support and the height at which it was seen. So it is stood on each of its sides in turn; the side that
leaves it nearest to where it was seen is believed.
"""

from collections.abc import Callable

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from typing_extensions import override

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.world.body_shapes import Solid
from phyagentos.protocol.world.descriptions import add_described
from phyagentos.protocol.world.environment import Entity, Environment, Shape, Status
from phyagentos.protocol.world.friction import FRICTION, PAIRS
from phyagentos.protocol.world.scenes import Body, Placement, SceneSpec
from phyagentos.runtime.drivers.mujoco.faults import FaultInjector
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.drivers.mujoco.world import SimulatedWorld

Array = NDArray[np.float64]

SETTLE_S = 0.3  # of simulated time, within which an object a millimetre inside its support comes to rest
SUNK_M = 0.004  # depths and calibration err by less than this
REACH_M = 0.1  # how far above its place a side is tried
CLIMB_M = 0.015  # an object that would have to rise by more stands beside the other one
HALVINGS = 12  # of that: a fortieth of a millimetre


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
    physics.actuation.place_at_home()
    physics.state.write_posture(data, np.array(target.q_rad))
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
    physics.actuation.set_servos(q, np.zeros_like(q), command_m)
    physics.step(round(SETTLE_S / model.opt.timestep))
    return physics.state.read_state()


def stand_up_sunk(model: mujoco.MjModel, data: mujoco.MjData, names: list[str]) -> list[str]:
    """Move the named free bodies that are sunk into others onto their support, the lowest first; names of the moved.

    No gripper may hold them; `data.qpos` is written.
    """
    moved = []
    above = sorted(names, key=lambda each: float(data.qpos[_find_start(model, each) + 2]))
    while above:
        name = above.pop(0)  # of two that are in each other the upper one gives way
        ignored = [model.body(each).id for each in above]
        if _measure_depth(model, data, name, ignored) > SUNK_M and _stand(model, data, name, ignored):
            moved.append(name)
    return moved


def _stand(model: mujoco.MjModel, data: mujoco.MjData, name: str, ignored: list[int]) -> bool:
    """Put a body on its most likely side; whether there is one."""
    start = _find_start(model, name)
    seen = np.array(data.qpos[start : start + 7])
    sides = []
    for side, quaternion in enumerate(_iter_sides(seen[3:])):
        data.qpos[start + 3 : start + 7] = quaternion
        height_m = _find_height(model, data, name, ignored, float(seen[2]))
        sides.append((abs(height_m - float(seen[2])), side, height_m, quaternion))
    climb_m, _, height_m, quaternion = min(sides, key=lambda each: each[:2])
    is_likely = climb_m <= CLIMB_M
    data.qpos[start : start + 7] = (*seen[:2], height_m, *quaternion) if is_likely else seen
    return is_likely


def _find_height(model: mujoco.MjModel, data: mujoco.MjData, name: str, ignored: list[int], seen_m: float) -> float:
    """Lowest height at which a body is in no other one, near the height at which it was seen [m]."""
    height = _find_start(model, name) + 2
    low, high = seen_m - REACH_M / 2, seen_m + REACH_M
    for _ in range(HALVINGS):
        middle = data.qpos[height] = (low + high) / 2
        is_free = _measure_depth(model, data, name, ignored) <= 0.0
        low, high = (low, middle) if is_free else (middle, high)
    return high


def _iter_sides(quaternion_wxyz: Array) -> list[Array]:
    """Turns with one of the body's axes upright, each by the least turn from the one given."""
    rotation = Rotation.from_quat(np.roll(quaternion_wxyz, -1))
    sides = []
    for axis in np.eye(3)[[2, 1, 0]]:
        now = rotation.apply(axis)
        upright = np.array([0.0, 0.0, 1.0 if now[2] >= 0.0 else -1.0])
        turn, _ = Rotation.align_vectors(upright[None], now[None])
        sides.append(np.roll((turn * rotation).as_quat(), 1))
    return sides


def _measure_depth(model: mujoco.MjModel, data: mujoco.MjData, name: str, ignored: list[int]) -> float:
    """How deep a body is in others than those ignored [m]; 0 outside of them."""
    mujoco.mj_kinematics(model, data)
    mujoco.mj_collision(model, data)
    bodies = model.geom_bodyid[data.contact.geom[: data.ncon]]
    own = (bodies == model.body(name).id).any(axis=1) & ~np.isin(bodies, ignored).any(axis=1)
    return max(0.0, -float(data.contact.dist[: data.ncon][own].min(initial=0.0)))


def _find_start(model: mujoco.MjModel, name: str) -> int:
    return int(model.jnt_qposadr[model.body(name).jntadr[0]])
