"""From a scene file and a seed to the bodies of a MuJoCo model, and to the entities they are.

Upstream: `protocol.scenes`, `robot`. Downstream: `world`. Every random number comes from one generator, drawn in the
order of the file, so a seed gives the same scene on every machine.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import ExecutionError
from phyagentos.protocol.environment import Entity, Interior, Pose, Region, Shape
from phyagentos.protocol.scenes import Body, Camera, Material, Placement, SceneSpec, Solid
from phyagentos.protocol.seeds import compute_seed

DRAWS = 2000  # tries for one position of an area before the scene is called overfull
TEXTURE_PIXELS = 128  # plain patterns need no more, and every model carries them
_GEOMS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
}
_BUILTIN = {
    "flat": mujoco.mjtBuiltin.mjBUILTIN_FLAT,
    "gradient": mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
    "checker": mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
}


@dataclass(frozen=True, slots=True)
class PlacedBody:
    """A body of the scene as this seed wants it: shapes after stretching, and where it starts."""

    name: str
    body: Body
    shapes: tuple[Solid, ...]
    position_m: tuple[float, float, float]
    yaw_rad: float

    @property
    def quaternion_wxyz(self) -> tuple[float, float, float, float]:
        """(4,) of the start."""
        return (float(np.cos(self.yaw_rad / 2)), 0.0, 0.0, float(np.sin(self.yaw_rad / 2)))

    def place(self, point_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """(3,) a point of this body's frame, in the world."""
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        x, y, z = point_m
        turned: NDArray[np.float64] = np.array((c * x - s * y, s * x + c * y, z))
        return turned + self.position_m

    def as_entity(self) -> Entity:
        """What a planner or a predicate must know of it; the pose is that of the start."""
        inside = self.body.interior
        return Entity(
            name=self.name,
            kind=self.body.kind,
            pose=Pose(self.position_m, self.quaternion_wxyz),
            movable=not self.body.fixed,
            shapes=tuple(
                Shape(solid.kind, solid.size_m, Pose(solid.position_m, _euler_to_quaternion(solid.euler_rad)))
                for solid in self.shapes
                if not solid.decor
            ),
            interior=Interior(inside.center_m, inside.half_m) if inside else None,
            color=self.body.color,
            source="simulator",
        )


def draw_bodies(spec: SceneSpec, seed: int) -> tuple[PlacedBody, ...]:
    """Decide where everything stands.

    Args:
        spec: The scene.
        seed: Of the scene.

    Raises:
        ExecutionError: `SCENE_OVERFULL` when an area has no room for all that is drawn from it.
    """
    rng = np.random.default_rng(compute_seed(seed, "scene", spec.scene))
    taken: dict[str, list[NDArray[np.float64]]] = {name: [] for name in spec.areas}
    placed: list[PlacedBody] = []
    for name, body in spec.bodies.items():
        position = _draw_position(spec, name, body.place, rng, taken)
        yaw = float(rng.uniform(*body.place.yaw_rad))
        if frame := next((item for item in placed if item.name == body.place.frame), None):
            position, yaw = frame.place(position), yaw + frame.yaw_rad
        shapes, lift = _stretch(body, rng)
        x, y, z = (float(value) for value in position)
        placed.append(PlacedBody(name, body, shapes, (x, y, z + lift), yaw))
    return tuple(placed)


def _draw_position(
    spec: SceneSpec,
    name: str,
    place: Placement,
    rng: np.random.Generator,
    taken: dict[str, list[NDArray[np.float64]]],
) -> NDArray[np.float64]:
    base: NDArray[np.float64] = np.array(place.position_m) + rng.uniform(-1.0, 1.0, 3) * np.array(place.jitter_m)
    if place.area is None:
        return base
    area = spec.areas[place.area]
    for _ in range(DRAWS):
        point = np.array([rng.uniform(*area.x_m), rng.uniform(*area.y_m)])
        if all(np.linalg.norm(point - other) >= area.spacing_m for other in taken[place.area]):
            taken[place.area].append(point)
            return np.array([point[0], point[1], base[2]])
    raise ExecutionError(
        "SCENE_OVERFULL",
        f"scene {spec.scene}: no room for {name!r} in area {place.area!r} with spacing {area.spacing_m} m; "
        "widen the area or lower the spacing",
    )


def _stretch(body: Body, rng: np.random.Generator) -> tuple[tuple[Solid, ...], float]:
    """Scale the height of a body that stands on its lower end; how much its centre rises [m]."""
    if body.stretch_z is None:
        return body.shapes, 0.0
    factor = float(rng.uniform(*body.stretch_z))
    shapes = tuple(
        solid.model_copy(
            update={
                "size_m": (*solid.size_m[:-1], solid.size_m[-1] * factor),
                "position_m": (*solid.position_m[:2], solid.position_m[2] * factor),
            }
        )
        for solid in body.shapes
    )
    half = max(solid.position_m[2] + solid.size_m[-1] for solid in body.shapes)
    return shapes, half * (factor - 1.0)


def add_scene(robot: mujoco.MjSpec, spec: SceneSpec, placed: tuple[PlacedBody, ...]) -> None:
    """Add floor, lights, cameras, materials and bodies to the robot's spec."""
    robot.modelname = spec.scene.replace("/", "_")
    _add_surroundings(robot, spec)
    for item in placed:
        _add_body(robot, item)


def _add_surroundings(robot: mujoco.MjSpec, spec: SceneSpec) -> None:
    sky = mujoco.mjtTexture.mjTEXTURE_SKYBOX
    robot.add_texture(
        name="sky", type=sky, builtin=_BUILTIN["gradient"], rgb1=[0.86, 0.9, 0.95], rgb2=[0.55, 0.62, 0.7],
        width=64, height=64,
    )  # fmt: skip
    for name, material in spec.materials.items():
        _add_material(robot, name, material)
    for name, light in spec.lights.items():
        robot.worldbody.add_light(
            name=name, pos=light.position_m, dir=light.direction, diffuse=light.diffuse, castshadow=light.shadow
        )
    for name, camera in spec.cameras.items():
        robot.worldbody.add_camera(name=name, pos=camera.position_m, fovy=camera.fovy_deg, xyaxes=_look_at(camera))


def _add_material(robot: mujoco.MjSpec, name: str, material: Material) -> None:
    added = robot.add_material(
        name=name,
        rgba=material.rgba,
        specular=material.specular,
        shininess=material.shininess,
        reflectance=material.reflectance,
    )
    texture = material.texture
    if texture is None:
        return
    robot.add_texture(
        name=name,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=_BUILTIN[texture.builtin],
        mark=mujoco.mjtMark.mjMARK_RANDOM if texture.random else mujoco.mjtMark.mjMARK_NONE,
        markrgb=texture.rgb2,
        random=texture.random,
        rgb1=texture.rgb1,
        rgb2=texture.rgb2,
        width=TEXTURE_PIXELS,
        height=TEXTURE_PIXELS,
    )
    names = list(added.textures)
    names[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = name
    added.textures = names
    added.texrepeat = texture.repeat


def _look_at(camera: Camera) -> list[float]:
    """(6,) x and y axis of a camera that looks at its target with its x axis level."""
    forward = np.array(camera.target_m) - np.array(camera.position_m)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    return [float(value) for value in (*right, *np.cross(right, forward))]


def _add_body(robot: mujoco.MjSpec, item: PlacedBody) -> None:
    body = robot.worldbody.add_body(name=item.name, pos=item.position_m, quat=item.quaternion_wxyz)
    if not item.body.fixed:
        body.add_freejoint(name=f"{item.name}_free")
    volumes = [0.0 if solid.decor else _compute_volume(solid) for solid in item.shapes]
    for index, (solid, volume) in enumerate(zip(item.shapes, volumes, strict=True)):
        geom = body.add_geom(
            name=item.name if index == 0 else f"{item.name}_{index}",
            type=_GEOMS[solid.kind],
            size=[*solid.size_m, 0.0, 0.0][:3],
            pos=solid.position_m,
            quat=_euler_to_quaternion(solid.euler_rad),
            mass=item.body.mass_kg * volume / sum(volumes),
            condim=3,  # the pads of a gripper have priority and torsional friction of their own
            friction=item.body.friction,
        )
        if material := solid.material or item.body.material:
            geom.material = material
        if solid.decor:
            geom.contype, geom.conaffinity, geom.group = 0, 0, 2


def _compute_volume(solid: Solid) -> float:
    size = solid.size_m
    if solid.kind == "box":
        return float(8 * np.prod(size))
    if solid.kind == "sphere":
        return float(4 / 3 * np.pi * size[0] ** 3)
    caps = 4 / 3 * np.pi * size[0] ** 3 if solid.kind == "capsule" else 0.0
    return float(2 * np.pi * size[0] ** 2 * size[1] + caps)


def _euler_to_quaternion(euler_rad: tuple[float, float, float]) -> tuple[float, float, float, float]:
    """Intrinsic x-y-z angles to (w, x, y, z)."""
    quaternion = np.zeros(4)
    mujoco.mju_euler2Quat(quaternion, np.array(euler_rad), "xyz")
    w, x, y, z = (float(value) for value in quaternion)
    return (w, x, y, z)


def read_regions(spec: SceneSpec, placed: tuple[PlacedBody, ...]) -> tuple[Region, ...]:
    """Named regions in the world; one that belongs to a body moves with where the seed put that body."""
    starts = {item.name: item for item in placed}
    regions = []
    for name, region in spec.regions.items():
        pose = Pose(region.center_m)
        if region.body is not None:
            item = starts[region.body]
            rotation = np.zeros(9)
            mujoco.mju_quat2Mat(rotation, np.array(item.quaternion_wxyz))
            offset = rotation.reshape(3, 3) @ np.array(region.center_m)
            x, y, z = (float(value) for value in np.array(item.position_m) + offset)
            pose = Pose((x, y, z), item.quaternion_wxyz)
        regions.append(Region(name=name, pose=pose, half_m=region.half_m))
    return tuple(regions)
