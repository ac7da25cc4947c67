"""The objects of a compiled MuJoCo model: what is welded together, its solids, its joint, handle, and room inside.

Everything is computed from the model's geometry, whatever objects are called. Boxes, cylinders, capsules and spheres
stay; a mesh becomes the box around its hull along its own axes. Poses are in the frame of a root that stands still.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SLIDE, HINGE = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
PLANE_HALF_M = (1.5, 1.5, 0.05)  # of a plane as a box
ALONG = 0.9  # cosine of the angle up to which two directions are one
PROUD_M = 0.002  # what stands this far beyond the face of a panel is a handle on it
FLAT_M = 0.012  # half the height up to which a marked box is a surface to put objects on, and not a room
SURFACE_M = 0.1  # room above such a surface
FLOOR_M = (-0.03, 0.05)  # where the solid that carries what stands on a mark is looked for, beside its middle
COVERED_M = 0.002  # what is seen nearer to a solid is of it
SAMPLE_M, SAMPLES = 0.002, 12000  # distance of points of a surface, and how many a mesh has at most
CELL_M, CELLS = 0.016, 20  # side of what one flat box covers, and how many of a row at most
CELL_POINTS = 8  # fewer points are no box
THIN_M, FLAT_BY_M = 0.0005, 0.0025  # half of the least thickness of such a box, and the greatest
_KINDS = {mujoco.mjtGeom.mjGEOM_BOX: "box", mujoco.mjtGeom.mjGEOM_CYLINDER: "cylinder",
          mujoco.mjtGeom.mjGEOM_CAPSULE: "capsule", mujoco.mjtGeom.mjGEOM_SPHERE: "sphere"}  # fmt: skip
_KINDS_BY_NUMBER = {int(geom): kind for geom, kind in _KINDS.items()}
_N_SIZES = {"box": 3, "cylinder": 2, "capsule": 2, "sphere": 1}


@dataclass(frozen=True)
class Solid:
    """One solid in the frame of its object.

    Attributes:
        half_m: (3,) of the box around it, along its own axes; `rotation` (3, 3) and `center_m` (3,) place it.
    """

    kind: str
    size_m: Array
    center_m: Array
    rotation: Array
    half_m: Array

    @property
    def corners_m(self) -> Array:
        """(8, 3) of the box around it."""
        signs = np.array(np.meshgrid((-1, 1), (-1, 1), (-1, 1))).reshape(3, -1).T
        corners: Array = self.center_m + (signs * self.half_m) @ self.rotation.T
        return corners

    def encode(self) -> dict[str, Any]:
        """As the wire has it."""
        pose = {"position_m": self.center_m.tolist(), "quaternion_wxyz": to_quaternion(self.rotation)}
        return {"kind": self.kind, "size_m": list(map(float, self.size_m)), "pose": pose}


@dataclass(frozen=True)
class Joint:
    """How an object opens.

    Attributes:
        kind: `slide` or `hinge`.
        address: Of its position in `qpos`.
        closed, opened: Its position [m or rad].
        axis: (3,) in the frame of the object, so that positive is opening; `anchor_m` (3,) is a point on it.
    """

    kind: str
    address: int
    closed: float
    opened: float
    axis: Array
    anchor_m: Array

    @property
    def travel(self) -> float:
        """From closed to open [m or rad]."""
        return abs(self.opened - self.closed)


@dataclass(frozen=True)
class Mark:
    """A box that the model marks: room inside an object, or room above a surface, in the frame of its object."""

    name: str
    center_m: Array
    half_m: Array
    rotation: Array
    is_surface: bool


@dataclass(frozen=True)
class SceneObject:
    """Bodies that are welded to each other.

    Attributes:
        body: The one whose frame it has.
        bodies: All of them.
        owner: Name of the object that it belongs to, as the task names it.
        part_of: Name of the object that it is fixed to: a handle of its drawer.
    """

    name: str
    owner: str
    kind: str
    body: int
    bodies: frozenset[int]
    geoms: tuple[int, ...]
    solids: tuple[Solid, ...]
    movable: bool
    joint: Joint | None = None
    part_of: str = ""
    marks: tuple[Mark, ...] = field(default=())

    @property
    def interior(self) -> Mark | None:
        """Where objects are put into it; None where it marks no room, or several."""
        rooms = [mark for mark in self.marks if not mark.is_surface]
        return rooms[0] if len(rooms) == 1 else None

    @property
    def regions(self) -> tuple[Mark, ...]:
        """The other marks."""
        return tuple(mark for mark in self.marks if mark is not self.interior)


def list_objects(
    model: Any,
    data: Any,
    owners: Mapping[int, str],
    kinds: Mapping[str, str],
    sites: Collection[str],
    skip: Sequence[str],
) -> list[SceneObject]:
    """All objects of a model, but for bodies whose names begin with one of `skip`.

    Args:
        model: The compiled model.
        data: A state in which nothing is held.
        owners: Names of objects by the body that is their root.
        kinds: Their kinds.
        sites: Names of the sites that mark rooms and surfaces.
        skip: Beginnings of the names of the robot's own bodies.
    """
    heads: dict[int, list[int]] = {}
    for body in range(model.nbody):
        if not model.body(body).name.startswith(tuple(skip)):
            heads.setdefault(_find_head(model, body), []).append(body)
    objects: list[SceneObject] = []
    for head, bodies in heads.items():
        geoms = _drop_doubles(model, [geom for body in bodies for geom in _list_geoms(model, body)])
        if geoms:
            objects += _make_objects(model, data, head, bodies, geoms, owners, kinds, sites)
    return objects


def _find_head(model: Any, body: int) -> int:
    """The body that it is welded to and that moves, or hangs from the world."""
    while body and not model.body_jntnum[body] and model.body_parentid[body]:
        body = int(model.body_parentid[body])
    return body


def cover_seen(model: Any, data: Any, item: SceneObject, group: int) -> list[Solid]:
    """Flat boxes over what is seen of an object where its solids are not: the cloth in a basket, the curve of a handle.

    Args:
        model: Compiled.
        data: A state with computed poses.
        item: Of the model.
        group: Of the geoms that are drawn.
    """
    turn, origin = data.xmat[item.body].reshape(3, 3), data.xpos[item.body]
    points = [
        (_sample_mesh(model, geom) @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom] - origin) @ turn
        for body in sorted(item.bodies)
        for geom in range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body])
        if int(model.geom_group[geom]) == group and int(model.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_MESH)
    ]
    seen = np.concatenate([np.zeros((0, 3)), *points])
    if not len(seen):
        return []
    left = seen[np.min([np.abs(_measure_box(solid, seen)) for solid in item.solids], axis=0) > COVERED_M]
    side_m = max(CELL_M, float(np.ptp(seen, axis=0).max()) / CELLS)
    _, cell = np.unique(np.floor(left / side_m).astype(int), axis=0, return_inverse=True)
    parts = [left[cell.ravel() == number] for number in range(int(cell.max()) + 1)] if len(left) else []
    return [solid for part in parts for solid in _flatten(part)]


def _sample_mesh(model: Any, geom: int) -> Array:
    """(n, 3) points of a mesh's surface in the frame of its geom, about `SAMPLE_M` apart."""
    mesh = int(model.geom_dataid[geom])
    first, face = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
    vertices = model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])].astype(np.float64)
    corners = vertices[model.mesh_face[face : face + int(model.mesh_facenum[mesh])]]  # (n, 3, 3)
    edges = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas = np.linalg.norm(np.cross(*edges), axis=1) / 2.0
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(corners), min(int(areas.sum() / SAMPLE_M**2) + 1, SAMPLES), p=areas / areas.sum())
    u, v = np.sort(rng.random((2, len(chosen), 1)), axis=0)  # evenly over the triangle with u and v - u
    found: Array = corners[chosen, 0] + u * edges[0][chosen] + (v - u) * edges[1][chosen]
    return found


def _measure_box(solid: Solid, points: Array) -> Array:
    """(n,) signed distances of points (n, 3) to the box around a solid."""
    away = np.abs((points - solid.center_m) @ solid.rotation) - solid.half_m
    found: Array = np.linalg.norm(np.maximum(away, 0.0), axis=1) + np.minimum(away.max(axis=1), 0.0)
    return found


def _flatten(points: Array) -> Iterator[Solid]:
    """Boxes of points (n, 3) along their principal axes; points that do not lie in a plane are halved."""
    if len(points) < CELL_POINTS:
        return
    _, _, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    axes *= np.linalg.det(axes)
    local = points @ axes.T
    low, high = np.percentile(local, (5, 95), axis=0)
    if high[2] - low[2] > FLAT_BY_M:
        upper = local[:, 0] > np.median(local[:, 0])
        yield from _flatten(points[upper])
        yield from _flatten(points[~upper])
        return
    half_m = np.maximum((high - low) / 2.0, THIN_M)
    yield Solid("box", half_m, (low + high) / 2.0 @ axes, axes.T, half_m)


def _find_owner(model: Any, body: int, owners: Mapping[int, str]) -> str:
    while body and body not in owners:
        body = int(model.body_parentid[body])
    return owners.get(body, "")


def _list_geoms(model: Any, body: int) -> list[int]:
    """Those that touch objects."""
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    return [g for g in range(first, first + count) if model.geom_contype[g] or model.geom_conaffinity[g]]


def _drop_doubles(model: Any, geoms: Sequence[int]) -> list[int]:
    """Without those that are the very solid of another one."""
    seen = {
        (
            model.geom_bodyid[g],
            model.geom_type[g],
            *(array[g].round(6).tobytes() for array in (model.geom_size, model.geom_pos, model.geom_quat)),
        ): g
        for g in reversed(geoms)
    }
    return sorted(seen.values())


def _make_objects(
    model: Any,
    data: Any,
    head: int,
    bodies: list[int],
    geoms: list[int],
    owners: Mapping[int, str],
    kinds: Mapping[str, str],
    sites: Collection[str],
) -> Iterator[SceneObject]:
    """The object of a head, and its handle where it has one."""
    owner = _find_owner(model, head, owners)
    joint = _read_joint(model, head)
    name = owners.get(head) or (model.body(head).name if head else "floor")
    is_free = bool(model.body_jntnum[head]) and joint is None
    solids = tuple(_read_solid(model, data, geom, head) for geom in geoms)
    handle = find_handle(solids, joint) if joint is not None else frozenset()
    kept = [index for index in range(len(solids)) if index not in handle] or list(range(len(solids)))
    kind = kinds.get(owner, "fixture") if head in owners or is_free else "part" if owner else "fixture"
    yield SceneObject(
        name=name,
        owner=owner,
        kind=kind,
        body=head,
        bodies=frozenset(bodies),
        geoms=tuple(geoms[index] for index in kept),
        solids=tuple(solids[index] for index in kept),
        movable=is_free or joint is not None,
        joint=joint,
        marks=tuple(_read_marks(model, data, head, bodies, sites, solids)),
    )
    if handle:
        yield SceneObject(
            name=f"{name}_handle",
            owner=owner,
            kind="handle",
            body=head,
            bodies=frozenset(),
            geoms=tuple(geoms[index] for index in sorted(handle)),
            solids=tuple(solids[index] for index in sorted(handle)),
            movable=True,
            part_of=name,
        )


def _read_joint(model: Any, body: int) -> Joint | None:
    """The slide or hinge of a body; closed is the end of its range that is nearer to where it is built."""
    if model.body_jntnum[body] != 1:
        return None
    number = int(model.body_jntadr[body])
    kind = int(model.jnt_type[number])
    if kind not in (SLIDE, HINGE):
        return None
    address = int(model.jnt_qposadr[number])
    ends = [float(end) for end in model.jnt_range[number]]
    closed, opened = sorted(ends, key=lambda end: abs(end - float(model.qpos0[address])))
    return Joint(
        kind="slide" if kind == SLIDE else "hinge",
        address=address,
        closed=closed,
        opened=opened,
        axis=np.sign(opened - closed) * np.array(model.jnt_axis[number]),
        anchor_m=np.array(model.jnt_pos[number]),
    )


def _read_solid(model: Any, data: Any, geom: int, head: int) -> Solid:
    rotation = data.xmat[head].reshape(3, 3).T @ data.geom_xmat[geom].reshape(3, 3)
    center_m = data.xmat[head].reshape(3, 3).T @ (data.geom_xpos[geom] - data.xpos[head])
    kind = _KINDS_BY_NUMBER.get(int(model.geom_type[geom]))
    if kind is not None:
        size_m = model.geom_size[geom][: _N_SIZES[kind]]
        return Solid(kind, size_m, center_m, rotation, _measure_half(kind, size_m))
    if int(model.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_PLANE):
        half_m = np.array(PLANE_HALF_M)
        return Solid("box", half_m, center_m - rotation[:, 2] * half_m[2], rotation, half_m)
    middle_m, half_m = model.geom_aabb[geom][:3], np.array(model.geom_aabb[geom][3:])
    return Solid("box", half_m, center_m + rotation @ middle_m, rotation, half_m)


def _measure_half(kind: str, size_m: Array) -> Array:
    """(3,) of the box around a solid."""
    if kind == "box":
        return np.array(size_m)
    height_m = {"cylinder": size_m[-1], "capsule": sum(size_m), "sphere": size_m[0]}[kind]
    return np.array((size_m[0], size_m[0], height_m))


def find_handle(solids: Sequence[Solid], joint: Joint) -> frozenset[int]:
    """The solids by which an object is opened: those that stand out from the face of its panel; none if none does.

    Of what slides the panel is across its way, and the outer face counts. Of what turns it is the largest one, and the
    side to which more stands out: a door, or the disc of a knob.
    """
    faces = [_find_face(solid) for solid in solids]
    largest = max(faces, key=lambda face: face[1])
    normal = joint.axis if joint.kind == "slide" else largest[0]
    panels = {index for index, (way, _) in enumerate(faces) if abs(float(way @ normal)) > ALONG}
    least = 0.5 * max((faces[index][1] for index in panels), default=0.0)
    outer = {index for index in panels if faces[index][1] > least}
    found: list[tuple[float, frozenset[int]]] = []
    for way in (normal,) if joint.kind == "slide" else (normal, -normal):
        face_m = max((float((solids[index].corners_m @ way).max()) for index in outer), default=np.inf)
        reach = {i: float((solid.corners_m @ way).max()) - face_m for i, solid in enumerate(solids) if i not in outer}
        proud = {i for i, by_m in reach.items() if by_m > PROUD_M and float(solids[i].center_m @ way) > face_m}
        found.append((max((reach[i] for i in proud), default=0.0), frozenset(proud)))
    return max(found, key=lambda each: each[0])[1]


def _find_face(solid: Solid) -> tuple[Array, float]:
    """Normal (3,) and area of its largest face."""
    thin = int(np.argmin(solid.half_m))
    wide = np.delete(solid.half_m, thin)
    return solid.rotation[:, thin], float(4.0 * wide[0] * wide[1])


def _read_marks(
    model: Any, data: Any, head: int, bodies: Collection[int], sites: Collection[str], solids: Sequence[Solid]
) -> Iterator[Mark]:
    for number in range(model.nsite):
        site = model.site(number)
        if int(model.site_bodyid[number]) not in bodies or site.name not in sites:
            continue
        if int(model.site_type[number]) != int(mujoco.mjtGeom.mjGEOM_BOX):
            continue
        world_R_head = data.xmat[head].reshape(3, 3)
        rotation = world_R_head.T @ data.site_xmat[number].reshape(3, 3)
        center_m = world_R_head.T @ (data.site_xpos[number] - data.xpos[head])
        yield make_mark(site.name, center_m, rotation, np.array(model.site_size[number]), world_R_head.T[:, 2], solids)


def make_mark(name: str, center_m: Array, rotation: Array, half_m: Array, up: Array, solids: Sequence[Solid]) -> Mark:
    """A mark whose bottom lies on what carries objects there, but not below the mark; room above it where it is flat.

    Args:
        name: Of the site.
        center_m: (3,) in the frame of the object.
        rotation: (3, 3) from its own axes to that frame.
        up: (3,) in that frame, points up in the world.
        half_m: (3,) along its own axes.
        solids: Of the object.
    """
    vertical = int(np.argmax(np.abs(rotation.T @ up)))  # becomes its z axis, upwards
    order = [(vertical + 1) % 3, (vertical + 2) % 3, vertical]
    sign = np.sign(up @ rotation[:, vertical])
    rotation, half_m, vertical = rotation[:, order] * np.array((1.0, sign, sign)), half_m[order], 2
    is_surface = bool(half_m[vertical] < FLAT_M)
    middle = float(center_m @ up)
    low, high = middle - float(half_m[vertical]), middle + float(half_m[vertical])
    tops = [top for solid in solids if (top := _find_top(solid, center_m, up)) is not None]
    least, most = (middle + FLOOR_M[0], middle + FLOOR_M[1]) if is_surface else (low - 0.02, middle)
    floor = max((top for top in tops if least <= top <= most), default=low)
    floor, high = (floor, min(floor, high) + SURFACE_M) if is_surface else (max(floor, low), high)
    half_m[vertical] = (high - floor) / 2.0
    return Mark(name, center_m + ((high + floor) / 2.0 - middle) * up, half_m, rotation, is_surface)


def narrow_turned(half_m: Array, rotation: Array) -> Array:
    """(3,) half sides of a box that is turned, as far as a world along whose axes it is read has it.

    LIBERO takes |R s| for the half sides (3,) of a room along the axes of the world: true of quarter turns only, and
    between them less than the box around the room. `rotation` (3, 3) is that of the box, whose z axis is about the
    vertical; the order and the signs of its axes need not be those of the site.
    """
    parts_m = np.abs(rotation) * half_m
    least_m = np.maximum(2.0 * parts_m.max(axis=1) - parts_m.sum(axis=1), 0.0)  # whatever the signs
    up = float(least_m[2] / parts_m[2].sum())
    aside = (least_m[:2] - up * parts_m[:2, 2]) / np.maximum(parts_m[:2, :2].sum(axis=1), 1e-9)
    least = float(aside.min())
    return half_m * np.clip((least, least, up), 0.0, up) if least > 0.0 else np.zeros(3)


def _find_top(solid: Solid, point_m: Array, up: Array) -> float | None:
    """Height at which a vertical line through a point (3,) leaves the box around a solid; None beside it."""
    start = solid.rotation.T @ (point_m - solid.center_m)
    way = solid.rotation.T @ up
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.sort(np.stack(((-solid.half_m - start) / way, (solid.half_m - start) / way)), axis=0)
    parallel = np.abs(way) < 1e-9
    if np.any(parallel & (np.abs(start) > solid.half_m)):
        return None
    enters, leaves = ends[0][~parallel].max(), ends[1][~parallel].min()
    return float(point_m @ up + leaves) if enters <= leaves else None


def to_quaternion(rotation: Array) -> list[float]:
    """(w, x, y, z) of a rotation (3, 3)."""
    found = np.empty(4)
    mujoco.mju_mat2Quat(found, rotation.ravel())
    return [float(each) for each in found]
