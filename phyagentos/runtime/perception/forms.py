"""What follows from a form alone: points of its surface, the turns that show, and those that look the same."""

from collections.abc import Iterator
from enum import StrEnum
from itertools import permutations, product

import numpy as np

from phyagentos.geometry import compute_matrix
from phyagentos.protocol.world.entity_geometry import compute_half_box
from phyagentos.protocol.world.environment import Entity, ShapeKind
from phyagentos.runtime.perception.solids import Array, Solids

SYMMETRY_M = 0.0005  # sides this equal are the same
RADIUS_SLACK_M = 0.003  # a ring of flat walls counts as round
LOOKALIKE_M = 0.006  # a form that a turn repeats to within this may be taken for itself, turned
OUT_M, SAMPLES_MAX = 1e-4, 3000
UNTURNED = 1e-3  # of the greatest moment of a surface: a turn about this axis shows nothing


class Form(StrEnum):
    """How far an orientation can be measured."""

    BOX = "box"
    """One box: up to its symmetries."""
    ROUND = "round"
    """Everything lies around its z axis: the turn about it cannot be measured."""
    BALL = "ball"
    """A sphere: no orientation at all."""
    FIXED = "fixed"
    """Upright as in the scene, within the span of its place."""


def find_form(entity: Entity) -> Form:
    """How far the orientation of an entity can be measured."""
    if len(entity.shapes) == 1 and entity.shapes[0].kind is ShapeKind.BOX:
        return Form.BOX
    if len(entity.shapes) == 1 and entity.shapes[0].kind is ShapeKind.SPHERE:
        return Form.BALL
    samples, _ = sample_surface(Solids.of(entity.shapes))
    radius = np.hypot(samples[:, 0], samples[:, 1])
    angle = np.arctan2(samples[:, 1], samples[:, 0])
    outer = [radius[np.abs(angle - a) < 0.3].max(initial=0.0) for a in np.arange(-2.8, 3.0, 0.56)]
    return Form.ROUND if max(outer) - min(outer) < RADIUS_SLACK_M else Form.BOX


def find_symmetries(entity: Entity, form: Form) -> Array:
    """Quarter turns about the axes of a single solid that leave it unchanged; the identity for other forms."""
    if form is not Form.BOX or len(entity.shapes) != 1:
        return np.eye(3)[None]
    half = np.array(compute_half_box(entity.shapes[0]))
    axes = compute_matrix(entity.shapes[0].pose)[:3, :3]
    same = (turned for turned in _QUARTER_TURNS if np.abs(np.abs(turned) @ half - half).max() < SYMMETRY_M)
    return np.array([axes @ turned @ axes.T for turned in same])


def _list_quarter_turns() -> tuple[Array, ...]:
    """The 24 rotations that bring axes onto axes."""
    orders = product(permutations(np.eye(3)), product((1.0, -1.0), repeat=3))
    candidates = (np.array(rows) * np.array(signs)[:, None] for rows, signs in orders)
    return tuple(each for each in candidates if np.linalg.det(each) > 0)


_QUARTER_TURNS = _list_quarter_turns()


def iter_lookalikes(solids: Solids, samples: Array, symmetries: Array, form: Form) -> Iterator[tuple[Array, Array]]:
    """Quarter turns that nearly repeat a form, each once up to its symmetries."""
    if form is Form.BALL:
        return
    middle = (samples.max(axis=0) + samples.min(axis=0)) / 2
    shown = [np.eye(3)]
    for turned in _QUARTER_TURNS:
        is_round = form is Form.ROUND and turned[2, 2] > 0.5
        if is_round or any(np.abs(turned @ each - other).max() < 1e-6 for each in symmetries for other in shown):
            continue
        moved = samples @ turned.T
        shift = middle - (moved.max(axis=0) + moved.min(axis=0)) / 2
        if float(np.abs(solids.measure(moved + shift)).max()) < LOOKALIKE_M:
            shown.append(turned)
            yield turned, shift


def find_turns(samples: Array, normals: Array, form: Form) -> Array:
    """(3, k) axes about which a turn moves the surface along its normals."""
    if form in (Form.BALL, Form.ROUND):
        return np.eye(3)[:, : 2 if form is Form.ROUND else 0]
    moments = np.cross(samples - samples.mean(axis=0), normals)
    strength, axes = np.linalg.eigh(moments.T @ moments)
    found: Array = axes[:, strength > UNTURNED * strength[-1]]
    return found


def sample_surface(solids: Solids) -> tuple[Array, Array]:
    """Points of the surface of the union with their normals, a few dozen per solid."""
    points, normals = [], []
    for index, kind in enumerate(solids.kinds):
        local, out = _sample_one(kind, solids.sizes_m[index])
        points.append(local @ solids.rotations[index].T + solids.positions_m[index])
        normals.append(out @ solids.rotations[index].T)
    every = 1 + sum(map(len, points)) // SAMPLES_MAX
    all_points, all_normals = np.concatenate(points)[::every], np.concatenate(normals)[::every]
    free = solids.measure(all_points + OUT_M * all_normals) > OUT_M / 2  # not where two solids touch
    return all_points[free], all_normals[free]


def _sample_one(kind: ShapeKind, size: tuple[float, ...]) -> tuple[Array, Array]:
    if kind is ShapeKind.BOX:
        return _sample_box(np.array(size))
    turns = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = np.column_stack((np.cos(turns), np.sin(turns), np.zeros(12)))
    radius = size[0]
    half = size[1] if len(size) > 1 else 0.0
    points, normals = [], []
    for z in np.linspace(-half, half, 4) if half > 0 else (0.0,):
        points.append(ring * radius + (0.0, 0.0, z))
        normals.append(ring)
    for sign in (1.0, -1.0):
        pole = np.array([0.0, 0.0, sign])
        for tilt in (0.5, 0.85):
            if kind is ShapeKind.CYLINDER:
                points.append(ring * radius * tilt + pole * half)
                normals.append(np.tile(pole, (12, 1)))
            else:
                out = ring * np.cos(tilt) + pole * np.sin(tilt)
                points.append(out * radius + pole * half)
                normals.append(out)
    return np.concatenate(points), np.concatenate(normals)


def _sample_box(half: Array) -> tuple[Array, Array]:
    grid = np.array([-0.9, -0.45, 0.0, 0.45, 0.9])
    points, normals = [], []
    for axis, sign in product(range(3), (1.0, -1.0)):
        u, v = np.meshgrid(grid, grid)
        local = np.zeros((25, 3))
        local[:, axis] = sign
        local[:, (axis + 1) % 3], local[:, (axis + 2) % 3] = u.ravel(), v.ravel()
        out = np.zeros((25, 3))
        out[:, axis] = sign
        points.append(local * half)
        normals.append(out)
    return np.concatenate(points), np.concatenate(normals)
