"""The robot as spheres: a cover of its solids that compiled code checks in about a microsecond.

One cluster per body with a bounding sphere. Pairs of clusters that look closer than they are get their threshold
calibrated over free postures; so the model may be wrong in both directions, and every final motion is checked exactly.
"""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np
from numba import njit
from numpy.typing import NDArray

from phyagentos.geometry import compute_inverse, compute_matrix, make_matrix
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.world.entity_geometry import compute_half_box
from phyagentos.protocol.world.environment import Entity, Shape
from phyagentos.runtime.motion.chain import Chain, compute_links
from phyagentos.runtime.motion.planning_scene import FIXED_MARGIN_M, MOVABLE_MARGIN_M, PAYLOAD_SCALE, PlanningScene
from phyagentos.runtime.motion.requests import Array
from phyagentos.runtime.motion.robot_model import RobotModel
from phyagentos.runtime.motion.shapes import compute_shape_boxes
from phyagentos.runtime.motion.tool_bounds import BALL_M, iter_walls

Integers = NDArray[np.int64]

COVER_EXCESS_M = 0.01  # how far a cover may stand out of a capsule
CELL_M = 0.009  # smallest half edge of the cells of a box
QUANTILE = 0.01  # of free postures that a calibrated pair may still refuse
SAMPLES = 1000
SEED = 0
YIELD_M = 1e-4  # further from what was touched: rounding must not touch it again
METRE_RAD = 2.0  # a metre of a base's way is as long as so much turning of a joint
_NEVER, MOVABLE, _FIXED, _WALL = 0, 1, 2, 4  # kinds of obstacles; other robots are movable
_ALL = MOVABLE | _FIXED


class SphereArrays(NamedTuple):
    """Input of the compiled kernels.

    Attributes:
        frames: (n + 1, 3, 4) of the chain.
        parents: (n + 1,) of its links.
        slides: Of the chain.
        spheres: (s, 4) centre in the link frame, radius.
        first: (c + 1,) index of the first sphere of each cluster.
        link: (c,) link of each cluster.
        bounds: (c, 4) bounding sphere of each cluster, in the link frame.
        meets: (c,) kinds of obstacles that each cluster is tested against: sum of 1 movable, 2 immovable, 4 walls.
        pairs: (p, 2) clusters tested against each other.
        shrink: (p,) calibrated reduction of their distance threshold [m].
        boxes: (b, 18) obstacles: centre, rotation by rows, half extents, and half extents along the world's axes.
        kinds: (b,) of the obstacles.
        crowd: (m, 4) spheres of other robots in the world: centre, radius; in groups like the own clusters.
        crowd_first: (g + 1,) index of the first sphere of each group.
        crowd_bounds: (g, 4) bounding sphere of each group.
        weights: (n,) of the joints in the length of a motion.
    """

    frames: Array
    parents: Integers
    slides: int
    spheres: Array
    first: Integers
    link: Integers
    bounds: Array
    meets: Integers
    pairs: Integers
    shrink: Array
    boxes: Array
    kinds: Integers
    crowd: Array
    crowd_first: Integers
    crowd_bounds: Array
    weights: Array

    def yield_at(self, q_rad: Array) -> "SphereArrays":
        """The same with whatever refuses a posture (n_joints,) among still obstacles smaller, until that is free."""
        links = np.zeros_like(self.frames)
        compute_links(q_rad, self.frames, self.parents, self.slides, links)
        cluster = np.repeat(np.arange(len(self.link)), np.diff(self.first))
        T = links[self.link[cluster]]  # (s, 3, 4)
        centers = np.einsum("srk,sk->sr", T[:, :, :3], self.spheres[:, :3]) + T[:, :, 3]
        local = np.einsum("sbr,brk->sbk", centers[:, None] - self.boxes[:, :3], self.boxes[:, 3:12].reshape(-1, 3, 3))
        gaps = np.linalg.norm(np.maximum(np.abs(local) - self.boxes[:, 12:15], 0.0), axis=2)  # (s, b)
        gaps[self.meets[cluster][:, None] & self.kinds == 0] = np.inf
        spheres, shrink = self.spheres.copy(), self.shrink.copy()
        spheres[:, 3] = np.clip(gaps.min(axis=1, initial=np.inf) - YIELD_M, 0.0, spheres[:, 3])
        for pair, members in enumerate(self.pairs):
            a, b = (slice(self.first[member], self.first[member + 1]) for member in members)
            between = np.linalg.norm(centers[a, None] - centers[b], axis=2)
            overlap = (spheres[a, 3, None] + spheres[b, 3] - between).max()
            shrink[pair] = max(shrink[pair], overlap + YIELD_M)
        return self._replace(spheres=spheres, shrink=shrink)

    def grow(self, margin_m: float) -> "SphereArrays":
        """The same with larger spheres."""
        wider = np.array((0.0, 0.0, 0.0, margin_m))
        return self._replace(spheres=self.spheres + wider, bounds=self.bounds + wider)

    def leave_alone(self) -> "SphereArrays":
        """The same without other robots."""
        return self._replace(**_join_groups(()))

    def meet_only(self, groups: Sequence[Array]) -> "SphereArrays":
        """The same robot among the spheres (k, 4) of these groups, and nothing else."""
        alone = self._replace(pairs=self.pairs[:0], shrink=self.shrink[:0], boxes=self.boxes[:0], kinds=self.kinds[:0])
        return alone._replace(**_join_groups(groups))


class SphereModel:
    """The calibrated sphere cover of one robot."""

    def __init__(self, robot: RobotModel, chain: Chain) -> None:
        model = robot.model
        self._chain, self._wrist = chain, robot.profile.arm.wrist_joints
        self._clusters = list(iter_clusters(robot, chain))
        self._pairs = _find_pairs(model, [int(b) for b in range(1, model.nbody) if model.body_geomnum[b]], chain)
        self._shrink = self._calibrate(robot)
        self._clusters.append((chain.tool, _WALL, np.append(chain.tcp[:, 3], BALL_M)[None]))
        self._bounds = [bound_spheres(cover) for _, _, cover in self._clusters]

    def build_arrays(self, scene: PlanningScene) -> SphereArrays:
        """The arrays for the scene as posed now, payload included."""
        clusters, bounds, pairs, shrink = self._clusters, self._bounds, self._pairs, self._shrink
        if scene.payload_shapes:
            last, tcp = self._chain.tool, np.vstack((self._chain.tcp, (0.0, 0.0, 0.0, 1.0)))
            cover = [move_spheres(cover_shape(s), compute_matrix(s.pose)) for s in scene.payload_shapes]
            held = move_spheres(np.vstack(cover), tcp @ scene.tcp_T_payload)
            links = [link for link, _, _ in clusters[:-1]]
            met = [(i, len(clusters)) for i, link in enumerate(links) if not last - self._wrist < link <= last]
            pairs, shrink = [*pairs, *met], [*shrink, *[0.0] * len(met)]
            clusters, bounds = [*clusters, (last, _ALL, held)], [*bounds, bound_spheres(held)]
        boxes, kinds = _box_obstacles(scene)
        return SphereArrays(
            frames=self._chain.frames,
            parents=self._chain.parents,
            slides=self._chain.slides,
            spheres=np.vstack([cover for _, _, cover in clusters]),
            first=np.cumsum([0, *(len(cover) for _, _, cover in clusters)]),
            link=np.array([link for link, _, _ in clusters]),
            bounds=np.array(bounds),
            meets=np.array([meets for _, meets, _ in clusters]),
            pairs=np.array(pairs, dtype=np.int64).reshape(-1, 2),
            shrink=np.array(shrink),
            boxes=boxes,
            kinds=kinds,
            weights=np.where(np.arange(len(self._chain.q_min_rad)) < self._chain.slides, METRE_RAD, 1.0),
            **_join_groups([group for groups in scene.crowd.values() for group in groups]),
        )

    def _calibrate(self, robot: RobotModel) -> list[float]:
        """Reduce each pair's threshold until only 1 % of the exactly free postures look closer than it."""
        data, free = mujoco.MjData(robot.model), []
        rng = np.random.default_rng(SEED)
        for q in rng.uniform(robot.q_min_rad, robot.q_max_rad, size=(SAMPLES, robot.model.nq)):
            data.qpos[:] = q
            mujoco.mj_kinematics(robot.model, data)
            mujoco.mj_collision(robot.model, data)
            if not data.ncon:
                free.append(q)
        links = np.zeros((len(free), *self._chain.frames.shape))
        for q, row in zip(free, links, strict=True):
            compute_links(q, self._chain.frames, self._chain.parents, self._chain.slides, row)
        placed = [  # (n, k, 3) centres of each cluster in every free posture
            cover[:, :3] @ links[:, link, :, :3].transpose(0, 2, 1) + links[:, None, link, :, 3]
            for link, _, cover in self._clusters
        ]
        gaps = [self._compute_gaps(placed, a, b) for a, b in self._pairs]
        quantiles = np.array([np.quantile(each, QUANTILE) for each in gaps])  # empty for a rigid body
        return [float(1e-4 - gap) if gap < 0.0 else 0.0 for gap in quantiles]

    def _compute_gaps(self, centers: list[Array], a: int, b: int) -> Array:
        """Between two clusters in every posture (n,) [m]; `centers` are (n, k, 3) each."""
        radii = self._clusters[a][2][:, 3, None] + self._clusters[b][2][:, 3]
        between = np.linalg.norm(centers[a][:, :, None] - centers[b][:, None], axis=3)
        gaps: Array = (between - radii).min(axis=(1, 2))
        return gaps


@njit(cache=True, nogil=True, error_model="numpy")
def measure_steps(rows, frames, parents, slides, link, bounds):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201 - compiled
    """How far a point of the bounding spheres moves at most from each row (k, n_joints) to the next, (k - 1,) [m]."""
    steps = np.zeros(max(0, len(rows) - 1))
    old, new = np.zeros(frames.shape), np.zeros(frames.shape)
    for k in range(len(rows)):
        compute_links(rows[k], frames, parents, slides, new)
        for i in range(len(link) if k else 0):
            T, before = new[link[i]], old[link[i]]
            shifted, turned = 0.0, 0.0
            for r in range(3):
                by = T[r, 3] - before[r, 3]
                for c in range(3):
                    change = T[r, c] - before[r, c]
                    by, turned = by + change * bounds[i, c], turned + change**2
                shifted += by**2
            steps[k - 1] = max(steps[k - 1], np.sqrt(shifted) + bounds[i, 3] * np.sqrt(turned / 2.0))
        old, new = new, old
    return steps


def iter_clusters(robot: RobotModel, chain: Chain) -> Iterator[tuple[int, int, Array]]:
    """Link, kinds of obstacles and cover (k, 4) in the link's frame of each body."""
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    mounting = {int(model.body(name).id) for name in robot.mounting}
    for body in range(1, model.nbody):
        link = chain.link_of_body[body]
        parts = [
            move_spheres(_cover_geom(model, geom), compute_inverse(chain.zero[link]) @ _geom_pose(data, geom))
            for geom in range(model.ngeom)
            if model.geom_bodyid[geom] == body
        ]
        if parts:
            meets = _NEVER if link == 0 else MOVABLE if body in mounting else _ALL
            yield link, meets, np.vstack(parts)


def _join_groups(groups: Sequence[Array]) -> Fields:
    return {
        "crowd": np.vstack([np.empty((0, 4)), *groups]),
        "crowd_first": np.cumsum([0, *map(len, groups)]),
        "crowd_bounds": np.array([bound_spheres(group) for group in groups]).reshape(-1, 4),
    }


def _find_pairs(model: mujoco.MjModel, bodies: list[int], chain: Chain) -> list[tuple[int, int]]:
    """Indices of clusters whose bodies the exact model tests against each other."""
    excluded = {(int(s) >> 16, int(s) & 0xFFFF) for s in model.exclude_signature}
    return [
        (i, j)
        for i, a in enumerate(bodies)
        for j, b in enumerate(bodies)
        if i < j and chain.link_of_body[a] != chain.link_of_body[b] and not {(a, b), (b, a)} & excluded
    ]


def _cover_geom(model: mujoco.MjModel, geom: int) -> Array:
    """Spheres (k, 4) in the geom's frame that together contain it."""
    size = model.geom_size[geom]
    match int(model.geom_type[geom]):
        case int(mujoco.mjtGeom.mjGEOM_SPHERE):
            return np.array([[0.0, 0.0, 0.0, size[0]]])
        case int(mujoco.mjtGeom.mjGEOM_CAPSULE):
            return _cover_capsule(float(size[0]), float(size[1]))
        case int(mujoco.mjtGeom.mjGEOM_BOX):
            return _cover_box(size, np.maximum(1, np.round(size / max(size.min(), CELL_M))).astype(int))
        case _:
            center, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
            cover = _cover_box(half, np.maximum(1, np.round(half / max(half.min(), CELL_M))).astype(int))
            cover[:, :3] += center
            return cover


def _cover_capsule(radius_m: float, half_m: float) -> Array:
    half_step = np.sqrt((radius_m + COVER_EXCESS_M) ** 2 - radius_m**2)
    k = max(1, int(np.ceil(half_m / half_step)))
    step = 2.0 * half_m / k
    inner = [(0.0, 0.0, z, np.hypot(radius_m, step / 2.0)) for z in -half_m + step * (np.arange(k) + 0.5)]
    return np.array([*inner, (0.0, 0.0, -half_m, radius_m), (0.0, 0.0, half_m, radius_m)])


def _cover_box(half_m: Array, cells: Integers) -> Array:
    cell = half_m / np.minimum(cells, 6)
    axes = [np.arange(-h + c, h, 2.0 * c) for h, c in zip(half_m, cell, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.column_stack((grid, np.full(len(grid), np.linalg.norm(cell))))


def cover_shape(shape: Shape) -> Array:
    """Spheres (k, 4) in the frame of a held solid that together contain it."""
    half = np.array(compute_half_box(shape)) * PAYLOAD_SCALE
    return _cover_box(half, np.clip(np.round(half / 0.01), 1, 4).astype(int))


def move_spheres(spheres: Array, T: Array) -> Array:
    """Spheres (k, 4) in the frame in which theirs has the pose `T` (4, 4)."""
    return np.column_stack((spheres[:, :3] @ T[:3, :3].T + T[:3, 3], spheres[:, 3]))


def _geom_pose(data: mujoco.MjData, geom: int) -> Array:
    return make_matrix(data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom])


def bound_spheres(spheres: Array) -> Array:
    """(4,) a sphere that contains all of these (k, 4)."""
    center = (spheres[:, :3].min(axis=0) + spheres[:, :3].max(axis=0)) / 2.0
    return np.append(center, (np.linalg.norm(spheres[:, :3] - center, axis=1) + spheres[:, 3]).max())


def _box_obstacles(scene: PlanningScene) -> tuple[Array, Integers]:
    rows, kinds = [np.empty((0, 18))], list[int]()
    for entity in scene.obstacles:
        rows.append(_enclose(entity, MOVABLE_MARGIN_M if entity.movable else FIXED_MARGIN_M))
        kinds += [MOVABLE if entity.movable else _FIXED] * len(rows[-1])
    for _, center_m, half_m in iter_walls(scene.robot.bounds):
        rows.append(_make_row(center_m, np.eye(3), half_m)[None])
        kinds.append(_WALL)
    return np.vstack(rows), np.array(kinds, dtype=np.int64)


@lru_cache(maxsize=256)
def _enclose(entity: Entity, margin_m: float) -> Array:
    """(b, 18) rows of boxes around its solids."""
    boxes = [(each.pose, each.half_m + margin_m) for each in compute_shape_boxes(entity)]
    return np.array([_make_row(T[:3, 3], T[:3, :3], half_m) for T, half_m in boxes]).reshape(-1, 18)


def _make_row(center_m: Array, rotation: Array, half_m: Array) -> Array:
    return np.concatenate((center_m, rotation.reshape(9), half_m, np.abs(rotation) @ half_m))
