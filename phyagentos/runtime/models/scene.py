"""From a scene file and a seed to the bodies of a MuJoCo model, and to the entities they are.

Random numbers come from one generator, drawn in the order of the file: a seed gives one scene on every machine.
"""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import ExecutionError
from phyagentos.geometry import compute_rotation, convert_euler, multiply, to_parent, turn
from phyagentos.protocol.world.body_shapes import Solid
from phyagentos.protocol.world.entity_geometry import compute_volume
from phyagentos.protocol.world.environment import UNNAMED, Entity, Interior, Mechanism, Pose, Region, Shape, ShapeKind
from phyagentos.protocol.world.scenes import Body, Joint, Material, SceneSpec
from phyagentos.protocol.world.seeds import compute_seed
from phyagentos.runtime.models.camera_model import look_at
from phyagentos.runtime.models.surfaces import find_surface

DRAWS = 2000  # tries for one position of an area before its layout is given up
LAYOUTS = 20  # that are tried before the scene is called overfull
IDEAL_FRICTION = (1.0, 0.02, 0.001)  # where a scene names neither surface nor friction
GRIP_PRIORITY = 3  # above that of finger pads
GRIP_SOLREF, GRIP_IMPEDANCE = (0.005, 1.0), (0.95, 0.99, 0.001)  # as the pads of the shipped gripper
TEXTURE_PIXELS = 128  # plain patterns need no more, and every model carries them
GEOM_TYPES = {
    ShapeKind.BOX: mujoco.mjtGeom.mjGEOM_BOX,
    ShapeKind.CYLINDER: mujoco.mjtGeom.mjGEOM_CYLINDER,
    ShapeKind.CAPSULE: mujoco.mjtGeom.mjGEOM_CAPSULE,
    ShapeKind.SPHERE: mujoco.mjtGeom.mjGEOM_SPHERE,
}
STICTION = (0.999, 0.9999, 0.001, 0.5, 2.0)  # MuJoCo's own (0.9, 0.95, ...) lets what hangs on a slide creep by 10 mm/s
_BUILTIN = {
    "flat": mujoco.mjtBuiltin.mjBUILTIN_FLAT,
    "gradient": mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
    "checker": mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
}


@dataclass(frozen=True, slots=True)
class PlacedBody:
    """A body of the scene as drawn: shapes after stretching, weight, grip, and start pose."""

    name: str
    body: Body
    shapes: tuple[Solid, ...]
    position_m: tuple[float, float, float]
    yaw_rad: float
    mass_kg: float
    grip: float | None  # coefficient of friction against the finger pads; None where the pads decide
    opening: float | None = None  # fraction of the joint's travel; None without a joint

    @property
    def quaternion_wxyz(self) -> tuple[float, float, float, float]:
        """(4,) of the start."""
        closed = multiply(_about_z(self.yaw_rad), convert_euler(self.body.place.euler_rad))
        joint = self.body.joint
        if joint is None or joint.kind != "hinge" or self.opening is None:
            return closed
        half_rad = joint.travel * self.opening / 2
        x, y, z = (float(np.sin(half_rad)) * each for each in joint.axis)
        return multiply(closed, (float(np.cos(half_rad)), x, y, z))

    def place(self, point_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """(3,) a point of this body's frame, in the world."""
        if any(self.body.place.euler_rad) or (self.body.joint is not None and self.body.joint.kind == "hinge"):
            return compute_rotation(self.quaternion_wxyz) @ point_m + self.position_m
        return _turn(point_m, self.yaw_rad) + self.position_m

    def as_entity(self) -> Entity:
        """The entity for planners and predicates, at its start pose."""
        inside = self.body.interior
        return Entity(
            name=self.name,
            kind=self.body.kind if self.body.listed else UNNAMED,
            form="" if self.body.listed else self.body.kind,
            pose=Pose(self.position_m, self.quaternion_wxyz),
            movable=not self.body.fixed,
            shapes=tuple(
                Shape(solid.kind, solid.size_m, Pose(solid.position_m, convert_euler(solid.euler_rad)))
                for solid in self.shapes
                if not solid.decor
            ),
            interior=Interior(inside.center_m, inside.half_m) if inside else None,
            joint=self.opening,
            mechanism=self._describe_joint(),
            part_of=self.body.part_of or "",
            color=self.body.color,
            source="simulator",
        )

    def _describe_joint(self) -> Mechanism | None:
        joint = self.body.joint
        if joint is None or self.opening is None:
            return None
        x, y, z = (float(value) for value in np.array(self.position_m) - _open(self.yaw_rad, joint, self.opening))
        return joint.place(Pose((x, y, z), _about_z(self.yaw_rad)))


def _open(yaw_rad: float, joint: Joint, fraction: float) -> NDArray[np.float64]:
    """(3,) displacement of a body's origin that opens it by a fraction of its travel."""
    amount, axis, anchor = joint.travel * fraction, np.array(joint.axis), np.array(joint.anchor_m)
    return _turn(axis * amount if joint.kind != "hinge" else anchor - turn(axis * amount) @ anchor, yaw_rad)


def _about_z(yaw_rad: float) -> tuple[float, float, float, float]:
    return (float(np.cos(yaw_rad / 2)), 0.0, 0.0, float(np.sin(yaw_rad / 2)))


def _turn(point_m: NDArray[np.float64], yaw_rad: float) -> NDArray[np.float64]:
    """(3,) a point, turned about z."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    x, y, z = point_m
    return np.array((c * x - s * y, s * x + c * y, z))


def draw_bodies(spec: SceneSpec, seed: int) -> tuple[PlacedBody, ...]:
    """Draw the start of every body; where one finds no room, all are drawn again, up to `LAYOUTS` times.

    Raises:
        ExecutionError: `SCENE_INVALID` when an area has no room for all that is drawn from it.
    """
    for layout in range(1, LAYOUTS):
        try:
            return _draw_layout(spec, seed, compute_seed(seed, "scene", spec.scene, *([layout] if layout > 1 else [])))
        except ExecutionError:
            continue
    return _draw_layout(spec, seed, compute_seed(seed, "scene", spec.scene, LAYOUTS))


def _draw_layout(spec: SceneSpec, seed: int, layout_seed: int) -> tuple[PlacedBody, ...]:
    rng = np.random.default_rng(layout_seed)
    placed: list[PlacedBody] = []
    for name, body in spec.bodies.items():
        position = _draw_position(spec, name, rng, placed)
        yaw = float(rng.uniform(*body.place.yaw_rad))
        if frame := next((item for item in placed if item.name == (body.place.frame or body.part_of)), None):
            position, yaw = frame.place(position), yaw + frame.yaw_rad
        shapes, lift = _stretch(body, rng)
        x, y, z = (float(value) for value in position)
        start, opening = (x, y, z + lift), None
        if body.joint is not None:
            opening = float(np.random.default_rng(compute_seed(seed, "opening", name)).uniform(*body.joint.opening))
            x, y, z = (float(value) for value in _open(yaw, body.joint, opening) + start)
            start = (x, y, z)
        mass_kg, grip = _draw_properties(body, compute_seed(seed, "properties", name))
        placed.append(PlacedBody(name, body, shapes, start, yaw, mass_kg, grip, opening))
    return tuple(placed)


def _draw_properties(body: Body, seed: int) -> tuple[float, float | None]:
    """True weight [kg] and friction of a body; no position depends on these draws."""
    rng = np.random.default_rng(seed)
    mass_kg = float(rng.uniform(*body.mass_span_kg)) if body.mass_span_kg else body.mass_kg
    grip = float(rng.uniform(*body.grip_span)) if body.grip_span else None
    return mass_kg, grip


def _draw_position(
    spec: SceneSpec, name: str, rng: np.random.Generator, placed: Sequence[PlacedBody]
) -> NDArray[np.float64]:
    place = spec.bodies[name].place
    base: NDArray[np.float64] = np.array(place.position_m) + rng.uniform(-1.0, 1.0, 3) * np.array(place.jitter_m)
    if place.area is None:
        return base
    area = spec.areas[place.area]
    others = [
        (
            np.array(each.position_m[:2]),
            area.spacing_m if each.body.place.area == place.area else area.clear_m[each.name],
        )
        for each in placed
        if each.body.place.area == place.area or each.name in area.clear_m
    ]
    for _ in range(DRAWS):
        point = np.array([rng.uniform(*area.x_m), rng.uniform(*area.y_m)])
        if all(np.linalg.norm(point - other) >= distance_m for other, distance_m in others):
            return np.array([point[0], point[1], base[2]])
    raise ExecutionError(
        "SCENE_INVALID",
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
    taken = {material.name for material in robot.materials}
    materials = {name: f"scene/{name}" if name in taken else name for name in spec.materials}
    _add_surroundings(robot, spec, materials)
    names = frozenset(item.name for item in placed)
    for item in placed:
        _add_body(robot, item, names, spec, materials)


def _add_surroundings(robot: mujoco.MjSpec, spec: SceneSpec, materials: Mapping[str, str]) -> None:
    sky = mujoco.mjtTexture.mjTEXTURE_SKYBOX
    robot.add_texture(
        name="sky", type=sky, builtin=_BUILTIN["gradient"], rgb1=[0.86, 0.9, 0.95], rgb2=[0.55, 0.62, 0.7],
        width=64, height=64,
    )  # fmt: skip
    for name, material in spec.materials.items():
        _add_material(robot, materials[name], material)
    for name, light in spec.lights.items():
        robot.worldbody.add_light(
            name=name, pos=light.position_m, dir=light.direction, diffuse=light.diffuse, castshadow=light.shadow
        )
    for name, camera in spec.cameras.items():
        robot.worldbody.add_camera(
            name=name, pos=camera.position_m, fovy=camera.fovy_deg, xyaxes=aim(camera.position_m, camera.target_m)
        )


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


def aim(
    position_m: Sequence[float] | NDArray[np.float64], target_m: Sequence[float] | NDArray[np.float64]
) -> list[float]:
    """Axes x and y of a camera, right and up, that looks from a point at another, upright."""
    right, _, forward = look_at(np.array(position_m), np.array(target_m), np.array((0.0, 0.0, 1.0))).rotation.T
    return [float(value) for value in (*right, *np.cross(right, forward))]


def _name_solid(body: str, index: int, bodies: Set[str]) -> str:
    """The first solid has the name of its body, the next ones its name and a number: none that of another body."""
    between = "_"
    while f"{body}{between}{index}" in bodies:
        between += ":"
    return f"{body}{between}{index}" if index else body


def _add_body(
    robot: mujoco.MjSpec, item: PlacedBody, bodies: Set[str], spec: SceneSpec, materials: Mapping[str, str]
) -> None:
    place = item.body.place
    if item.body.part_of is None:
        body = robot.worldbody.add_body(name=item.name, pos=item.position_m, quat=item.quaternion_wxyz)
    else:
        body = robot.body(item.body.part_of).add_body(
            name=item.name,
            pos=place.position_m,
            quat=multiply(convert_euler((0.0, 0.0, place.yaw_rad[0])), convert_euler(place.euler_rad)),
        )
    if item.body.joint is not None and item.opening is not None:
        _add_joint(body, item.name, item.body.joint, item.opening)
    elif not item.body.fixed and item.body.part_of is None:
        body.add_freejoint(name=f"{item.name}_free")
    volumes = [0.0 if solid.decor else compute_volume(solid.kind, solid.size_m) for solid in item.shapes]
    for index, (solid, volume) in enumerate(zip(item.shapes, volumes, strict=True)):
        geom = body.add_geom(
            name=_name_solid(item.name, index, bodies),
            type=GEOM_TYPES[solid.kind],
            size=[*solid.size_m, 0.0, 0.0][:3],
            pos=solid.position_m,
            quat=convert_euler(solid.euler_rad),
            mass=item.mass_kg * volume / (sum(volumes) or 1.0),
            condim=3,  # unless a surface says more: see `surfaces`
            friction=item.body.friction or IDEAL_FRICTION,
        )
        if item.grip is not None and find_surface(spec, item.body, solid) is None:
            _decide_grip(geom, item.grip)
        if material := solid.material or item.body.material:
            geom.material = materials[material]
        if solid.decor:
            geom.contype, geom.conaffinity, geom.group = 0, 0, 2


def _add_joint(body: mujoco.MjsBody, name: str, joint: Joint, opening: float) -> None:
    """A slide or hinge whose position is zero when it is closed, and which begins open by a fraction."""
    body.add_joint(
        name=f"{name}_joint",
        type=mujoco.mjtJoint.mjJNT_SLIDE if joint.kind != "hinge" else mujoco.mjtJoint.mjJNT_HINGE,
        axis=joint.axis,
        pos=joint.anchor_m,
        ref=joint.travel * opening,
        range=(0.0, joint.travel),
        stiffness=joint.spring,
        springref=joint.travel,
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        damping=joint.damping,
        frictionloss=joint.friction,
        solimp_friction=STICTION,
    )


def _decide_grip(geom: mujoco.MjsGeom, friction: float) -> None:
    """The object's surface decides the grip: above the pads' priority, and as stiff as they are."""
    geom.priority, geom.condim, geom.friction = GRIP_PRIORITY, 4, (friction, 0.02 * friction, 0.001)
    geom.solref, geom.solimp = GRIP_SOLREF, (*GRIP_IMPEDANCE, 0.5, 2.0)


def read_regions(spec: SceneSpec, placed: tuple[PlacedBody, ...]) -> tuple[Region, ...]:
    """Named regions in the world; one that belongs to a body is placed with that body."""
    starts = {item.name: item for item in placed}
    regions = []
    for name, region in spec.regions.items():
        pose = Pose(region.center_m)
        if region.body is not None:
            item = starts[region.body]
            placed_at = Pose(item.position_m, item.quaternion_wxyz)
            pose = Pose(to_parent(placed_at, region.center_m), item.quaternion_wxyz)
        regions.append(Region(name=name, pose=pose, half_m=region.half_m))
    return tuple(regions)
