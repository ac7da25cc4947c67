"""Free sites judged by solids, for what finds no room as a box: a handle that is higher than a wall, a rim, an angle.

Upstream: `sites`, which judges by boxes and circles at a fraction of the cost. Downstream: `placements`. MuJoCo checks
each pose of the payload, alone, against every solid of the world.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import mujoco
import numpy as np
from msgspec.structs import replace as change

from phyagentos.geometry import compute_quaternion
from phyagentos.protocol.world.entity_geometry import compute_extent
from phyagentos.protocol.world.environment import Entity
from phyagentos.runtime.motion.job import Job
from phyagentos.runtime.motion.requests import Array
from phyagentos.runtime.motion.shapes import compute_bounds, compute_shape_boxes
from phyagentos.runtime.motion.sites import FreePlacement, Placing, Sites, Space, is_borne, measure_rectangle
from phyagentos.runtime.motion.solids import add_geoms

GAPS_M = (0.006, 0.003)  # to everything beside it; the second where the first leaves no room
OVER_FLOOR_M = 0.001  # between a payload that is checked and the floor with its gap
INSIDE_M = 0.012  # of its middle from the sides: what perception may be off
STEP_M = 0.01  # between points that are checked
STEPS_MAX = 40  # along one side
APART_M = 0.025  # between sites of one yaw: nearer ones meet the same obstacles
SITES_PER_YAW = 6
SNUG_M = 1e-4  # beyond the gap

Ranked = tuple[tuple[float, ...], float, float]  # how good a point is, and where


def find_standing_sites(placing: Placing, attitudes: Mapping[int, Array], job: Job, enough: float = np.inf) -> Sites:
    """Sites at which no solid of the payload touches another one, those along the sides of the destination first.

    Only the payload's middle must be within the sides. `attitudes` maps yaws of the tool [degrees] to the attitude
    (3, 3) of the payload in the axes of the space. The search ends with the yaw that makes `enough` sites.
    """
    space, (interest_m, radius_m) = placing.space, placing.near
    from_m = space.rotation[:2, :2].T @ (interest_m - space.center_m)[:2]
    room = space.half_m - (INSIDE_M if space.walled else placing.footprint.inner_m)
    if np.any(room < 0.0) and space.walled:
        return Sites(iter(()))
    for gap_m in GAPS_M:
        checker = StandingRoom(placing, gap_m)
        sites: list[tuple[tuple[float, ...], FreePlacement]] = []
        for degrees, R in attitudes.items():
            if len(sites) >= enough:
                break
            start = checker.turn(R)
            snug = space.half_m - measure_rectangle(placing.held, R) - gap_m - SNUG_M
            points = [p for p in _list_points(np.maximum(room, 0.0), snug) if np.hypot(*(p - from_m)) <= radius_m]
            if (datum_m := placing.held.datum_m) is not None and space.walled:
                off_m = (R @ (np.array(datum_m) - placing.middle_m))[:2]
                points = [p for p in points if np.all(np.abs(p + off_m) <= room)]
            ranked = sorted((_rank(point, room, from_m, space), *point) for point in points)
            job.checkpoint()
            for rank, x, y in _spread(ranked, checker, start, space.rotation, job):
                site = FreePlacement(
                    name=f"stand{round(1e3 * x):+04d}{round(1e3 * y):+04d}",
                    point_m=space.center_m + space.rotation @ (x, y, 0.0),
                    yaws=(degrees,),
                )
                if is_borne(placing, site, R):
                    sites.append((rank, site))
        if sites:
            return Sites(iter([site for _, site in sorted(sites, key=lambda each: each[0])]))
    return Sites(iter(()))


def fit_tight(placing: Placing, attitudes: Mapping[int, Array], sites: Sites, job: Job) -> Sites:
    """The sites with the yaws at which the payload meets nothing: its box may reach through a low wall."""

    def iter_fitted() -> Iterator[FreePlacement]:
        room = None
        for site in sites:
            if not site.is_tight:
                yield site
                continue
            room = room or StandingRoom(placing, GAPS_M[-1])
            away_m = site.point_m - placing.space.center_m
            tried = (degrees for degrees in attitudes if site.yaws is None or degrees in site.yaws)
            yaws = tuple(each for each in tried if room.is_free(room.turn(attitudes[each]) + away_m))
            job.rejected["occupied"] += not yaws
            if yaws:
                yield replace(site, yaws=yaws)

    return Sites(iter_fitted())


def _find_near(placing: Placing) -> list[Entity]:
    """Entities that the payload may meet anywhere over the space."""
    space, held = placing.space, placing.held
    radius_m = float(np.linalg.norm(space.half_m) + np.linalg.norm(compute_bounds(held.shapes)[1])) + max(GAPS_M)
    return [
        each
        for each in placing.request.world.entities
        if each.name != held.name
        and any(box.compute_distance(space.center_m) <= radius_m for box in compute_shape_boxes(each))
    ]


def _list_points(room: Array, snug: Array) -> list[Array]:
    """Points (2,) of a lattice between the sides, and of lines where a box around the payload is close to a side."""
    axes = []
    for r, close in zip(room.tolist(), snug.tolist(), strict=True):
        lattice = np.linspace(-r, r, min(1 + int(np.ceil(2.0 * r / STEP_M)), STEPS_MAX)) if r > 0.0 else np.zeros(1)
        axes.append(np.union1d(lattice, (-close, close)) if 0.0 < close < r else lattice)
    return list(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2))


def _rank(point: Array, room: Array, from_m: Array, space: Space) -> tuple[float, ...]:
    """Smaller is better: along walls, so that the room that is left stays in one piece; then near."""
    walls = sorted((room - np.abs(point)).round(6).tolist()) if space.walled else []
    return (*walls, round(float(np.linalg.norm(point - from_m)), 6))


def _spread(ranked: list[Ranked], checker: "StandingRoom", start: Array, rotation: Array, job: Job) -> Iterator[Ranked]:
    """The first free points that are not near each other; over the middle of the space the payload is at `start`."""
    kept: list[Ranked] = []
    for rank, x, y in ranked:
        if len(kept) == SITES_PER_YAW:
            break
        if any(np.hypot(x - other[1], y - other[2]) < APART_M for other in kept):
            continue
        if checker.is_free(start + rotation[:, 0] * x + rotation[:, 1] * y):
            kept.append((rank, x, y))
            yield rank, x, y
        else:
            job.rejected["occupied"] += 1


class StandingRoom:
    """Contacts of the payload, alone, with everything around it, each inflated by a gap."""

    def __init__(self, placing: Placing, gap_m: float) -> None:
        spec = mujoco.MjSpec()
        body = spec.worldbody.add_body(name="payload")
        body.add_freejoint()
        add_geoms(body, placing.held.shapes, 1, 0)
        for other in _find_near(placing):
            inflated = tuple(change(s, size_m=tuple(part + gap_m for part in s.size_m)) for s in other.shapes)
            around = spec.worldbody.add_body(pos=other.pose.position_m, quat=other.pose.quaternion_wxyz)
            add_geoms(around, inflated, 0, 1)
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._held, self._space, self._over_m = placing.held, placing.space, gap_m + OVER_FLOOR_M
        self._middle_m = placing.middle_m

    def turn(self, R: Array) -> Array:
        """Give the payload an attitude (3, 3) in the space; its position (3,) over the middle of the space."""
        turned = self._space.rotation @ R
        self._data.qpos[3:] = compute_quaternion(turned)
        start: Array = self._space.center_m - turned @ self._middle_m
        lowest_m = compute_extent(self._held, tuple((-turned[2]).tolist()))[1]
        start[2] = self._space.center_m[2] + self._over_m + lowest_m
        return start

    def is_free(self, position_m: Array) -> bool:
        """Whether the payload touches nothing with its origin at a point (3,) of the world."""
        self._data.qpos[:3] = position_m
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_collision(self._model, self._data)
        return int(self._data.ncon) == 0
